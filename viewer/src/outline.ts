// What is in a scene, by name, as far as it fits what is sought.

import type { Scene } from 'rebake';
import { $ } from './dom';
import { listbox } from './lists';
import type { Picked } from './stage';

export function outline(scene: Scene | null, picked: Picked | null, choose: (next: Picked) => void): void {
  const chosen = (kind: string) => (picked?.kind === kind ? picked.name : null);
  const sought = $<HTMLInputElement>('search').value.trim().toLowerCase();
  const fits = ({ name }: { name: string }) => name.toLowerCase().includes(sought);
  const [objects, lights] = [scene?.objects.filter(fits) ?? [], scene?.lights.filter(fits) ?? []];
  const hidden = (is: boolean) => (is ? { note: 'hidden', isFaint: true } : {});
  const rows = objects.map(({ name, hidden: is }) => ({ name, ...hidden(is) }));
  listbox('objects', rows, chosen('object'), (name) => choose({ kind: 'object', name }));
  listbox('lights', lights.map(({ name, kind }) => ({ name, note: kind })), chosen('light'), (name) => choose({ kind: 'light', name }));
  const count = (shown: unknown[], all: unknown[] = []) =>
    all.length === 0 ? '' : shown.length === all.length ? `${all.length}` : `${shown.length} of ${all.length}`;
  $('object-count').textContent = count(objects, scene?.objects);
  $('light-count').textContent = count(lights, scene?.lights);
}
