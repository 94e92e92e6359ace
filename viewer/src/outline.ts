// What is in a scene, by name, as far as it fits what is sought. Objects that are called alike but for a number stand
// together, where there are many: a level has five hundred.

import type { Scene, SceneObject } from 'rebake';
import { $ } from './dom';
import { show, type Item } from './lists';
import type { Picked, Selection } from './selection';

/** So many objects of a kind make a group, in scenes of so many objects. */
const ALIKE = 3;
const MANY = 24;

const stem = (name: string) => name.replace(/[\s._-]*\d+$/, '') || name;

export class Outline {
  private readonly isOpen = new Set<string>();

  constructor(private readonly choose: (next: Picked[], isMore: boolean) => void) {}

  show(scene: Scene | null, selection: Selection): void {
    const sought = $<HTMLInputElement>('search').value.trim().toLowerCase();
    const fits = ({ name }: { name: string }) => name.toLowerCase().includes(sought);
    const [objects, lights] = [scene?.objects.filter(fits) ?? [], scene?.lights.filter(fits) ?? []];
    const of = (kind: Picked['kind']) => ({
      chosen: selection.names(kind),
      choose: (names: string[], isMore: boolean) => this.choose(names.map((name) => ({ kind, name })), isMore),
    });
    const open = (group: string, is: boolean) => {
      if (is) this.isOpen.add(group);
      else this.isOpen.delete(group);
      this.show(scene, selection);
    };
    const isGrouped = !sought && objects.length >= MANY;
    show('objects', isGrouped ? this.grouped(objects, selection.last) : objects.map(row), { ...of('object'), open });
    show('lights', lights.map(({ name, kind }) => ({ name, note: kind })), of('light'));
    const count = (shown: unknown[], all: unknown[] = []) =>
      all.length === 0 ? '' : shown.length === all.length ? `${all.length}` : `${shown.length} of ${all.length}`;
    $('object-count').textContent = count(objects, scene?.objects);
    $('light-count').textContent = count(lights, scene?.lights);
  }

  private grouped(objects: SceneObject[], last: Picked | null): Item[] {
    const alike = new Map<string, SceneObject[]>();
    for (const object of objects) alike.set(stem(object.name), [...(alike.get(stem(object.name)) ?? []), object]);
    return [...alike].flatMap(([name, those]) => {
      if (those.length < ALIKE) return those.map(row);
      // What was selected elsewhere is seen.
      const isOpen = this.isOpen.has(name) || (last?.kind === 'object' && those.some((one) => one.name === last.name));
      const head = { name, note: `× ${those.length}`, group: { names: those.map((one) => one.name), isOpen } };
      return [head, ...(isOpen ? those.map((one) => ({ ...row(one), isWithin: true })) : [])];
    });
  }
}

function row({ name, hidden }: SceneObject): Item {
  return hidden ? { name, note: 'hidden', isFaint: true } : { name };
}
