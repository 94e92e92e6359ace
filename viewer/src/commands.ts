// What can be done with what is selected, and what can be put in.

import { Box3, Matrix4, Vector3 } from 'three';
import type { Edit, Job, Light, NewLight, Point, Rgb, Scene, SceneObject } from 'rebake';
import { client } from './api';
import { freeName } from './dom';
import type { Editor } from './editor';
import { lamp, wanted, type LampKind } from './lamps';
import type { Thing } from './library';
import type { LightMap } from './lightmap';
import type { Picked, Selection } from './selection';
import type { Stage } from './stage';
import { onto, type Spot } from './surfaces';

interface Around {
  scene(): Scene | null;
  selection: Selection;
  choose(next: Picked[]): void;
  stops(): number;
  /** Steps in which things are placed, metres; 0: none. */
  grid(): number;
}

/** What is moved, as it stood when it was taken hold of. */
interface Held {
  objects: SceneObject[];
  lights: Light[];
  /** Steps of the drag that the service has heard of, and when it heard of the last one, milliseconds. */
  steps: number;
  last: number;
}

/** Between two steps of a drag, milliseconds. */
const STEP = 66;

const some = (names: { name: string }[]) => (names.length > 1 ? `${names[0]!.name} and ${names.length - 1} more` : names[0]!.name);

export class Commands {
  private held: Held | null = null;

  constructor(
    private readonly around: Around,
    private readonly editor: Editor,
    private readonly stage: Stage,
    private readonly map: LightMap,
  ) {}

  /** The objects that are selected. */
  get objects(): SceneObject[] {
    const names = new Set(this.around.selection.names('object'));
    return this.around.scene()?.objects.filter((o) => names.has(o.name)) ?? [];
  }

  /** The lights that are selected, but those on selected objects. */
  get lights(): Light[] {
    const { selection } = this.around;
    const [names, objects] = [new Set(selection.names('light')), new Set(selection.names('object'))];
    return this.around.scene()?.lights.filter((l) => names.has(l.name) && !(l.object && objects.has(l.object))) ?? [];
  }

  /** The light that is selected alone, or that of the object that is. */
  get light(): Light | undefined {
    const { all } = this.around.selection;
    const [one] = all;
    if (all.length !== 1 || !one) return undefined;
    return this.around.scene()?.lights.find((l) => (one.kind === 'light' ? l.name === one.name : l.object === one.name));
  }

  async remove(): Promise<void> {
    const { objects, lights } = this;
    const edits: Edit[] = lights.map(({ name }) => ({ op: 'remove_light', light: name }));
    if (objects.length) edits.unshift({ op: 'remove', objects: objects.map(({ name }) => name) });
    await this.run('remove', [...objects, ...lights], edits);
  }

  /** All that is selected; brought back where none of it is shown. */
  async hide(is = this.objects.some((o) => !o.hidden)): Promise<void> {
    const those = this.objects.filter((o) => o.hidden !== is);
    await this.run(is ? 'hide' : 'show', those, [{ op: is ? 'hide' : 'show', objects: those.map(({ name }) => name) }]);
  }

  /** It is taken hold of: what it moves by counts from here. */
  grab(): void {
    this.held = structuredClone({ objects: this.objects, lights: this.lights, steps: 0, last: 0 });
  }

  /** It is lit where it is dragged along, as often as the service takes it. */
  async drag(by: Matrix4): Promise<void> {
    const { held } = this;
    const now = performance.now();
    if (!held || !this.editor.isIdle || now - held.last < STEP) return;
    const edits = moves(held, by, true);
    if (edits.length === 0) return;
    [held.steps, held.last] = [held.steps + 1, now];
    await this.editor.run(`move ${some([...held.objects, ...held.lights])}`, edits, held.steps > 1);
  }

  /** It is let go. */
  async drop(by: Matrix4): Promise<void> {
    const { held } = this;
    this.held = null;
    if (!held || (by.equals(new Matrix4()) && held.steps === 0)) return;
    await this.run('move', [...held.objects, ...held.lights], moves(held, by, false), held.steps > 0);
  }

  async move(by: Matrix4): Promise<void> {
    this.grab();
    await this.drop(by);
  }

  async aim(direction: Point): Promise<void> {
    const { light } = this;
    if (light) await this.run('turn', [light], [{ op: 'move_light', light: light.name, direction }]);
  }

  /** Each down onto what is below it, or up out of it. */
  async toFloor(): Promise<void> {
    const drops = this.stage.dropsOf(this.objects.map(({ name }) => name));
    const those = this.objects.filter(({ name }) => drops.has(name));
    const edits = those.map(({ name, transform }): Edit => {
      const down = new Matrix4().makeTranslation(0, drops.get(name)!, 0);
      return { op: 'move', object: name, transform: down.multiply(new Matrix4().fromArray(transform)).toArray() };
    });
    await this.run('put down', those, edits);
  }

  async paint(albedo: Rgb): Promise<void> {
    const { objects } = this;
    await this.run('repaint', objects, objects.map(({ name }) => ({ op: 'material', object: name, albedo })));
  }

  relight(light: Light, color: Rgb, intensity: number): Promise<Job | null> {
    return this.editor.run(`relight ${light.name}`, { op: 'relight', lights: [{ light: light.name, color, intensity }] });
  }

  /** All lights that are selected, those on objects too, so many times as strong. */
  async dim(factor: number): Promise<void> {
    const names = new Set(this.objects.map(({ name }) => name));
    const on = this.around.scene()?.lights.filter((l) => l.object && names.has(l.object)) ?? [];
    const lights = [...this.lights, ...on];
    await this.run('relight', lights, [{ op: 'relight', lights: lights.map(({ name, intensity }) => ({ light: name, intensity: intensity * factor })) }]);
  }

  /** Others of all that is selected, beside it. Pictures stay with the file: copies have the mean colour of their materials. */
  async duplicate(): Promise<void> {
    const scene = this.around.scene();
    if (!scene) return;
    const objects = this.objects.filter((o) => !o.hidden);
    const lights = this.lights.filter((l) => l.position && !l.object);
    const taken = [...scene.objects, ...scene.lights].map((one) => one.name);
    const named = (one: { name: string }) => taken[taken.push(freeName(one.name, taken)) - 1]!;
    const box = new Box3();
    for (const { bounds } of objects) box.union(new Box3(new Vector3(...bounds.min), new Vector3(...bounds.max)));
    const aside = box.isEmpty() ? 0.5 : (box.max.x - box.min.x) * 1.1 + 0.05;
    const transform = new Matrix4().makeTranslation(aside, 0, 0).toArray();
    const copies: Picked[] = [];
    const edits: Edit[] = [];
    for (const object of objects) {
      const { asset } = await client.asset(new Blob([await client.objectMesh(scene.id, object.name)]));
      copies.push({ kind: 'object', name: named(object) });
      edits.push({ op: 'insert', asset, name: copies.at(-1)!.name, transform });
    }
    for (const light of lights) {
      copies.push({ kind: 'light', name: named(light) });
      const { kind, color, intensity, position, direction } = light;
      const [x, y, z] = position!;
      const copy = { kind, color, intensity, position: [x + aside, y, z], ...(kind === 'spot' && { direction }) } as NewLight;
      edits.push({ op: 'insert_light', name: copies.at(-1)!.name, light: copy });
    }
    if (await this.run('duplicate', [...objects, ...lights], edits)) this.around.choose(copies);
  }

  /** Puts something from the library onto a surface; a picture of the sky is where the sky was. */
  async insert({ asset, name: wanted, box }: Thing, where: Spot): Promise<void> {
    const scene = this.around.scene();
    if (!scene) return;
    if (!box) {
      const sky = await this.editor.run(`sky ${wanted}`, { op: 'sky', asset });
      if (sky) this.around.choose([{ kind: 'light', name: 'environment' }]);
      return;
    }
    const name = freeName(wanted, [...scene.objects, ...scene.lights].map((one) => one.name));
    const transform = onto(box, where, this.around.grid()).toArray();
    if (await this.editor.run(`insert ${name}`, { op: 'insert', asset, name, transform })) this.around.choose([{ kind: 'object', name }]);
  }

  async addLight(kind: LampKind): Promise<void> {
    const scene = this.around.scene();
    if (!scene) return;
    const value = wanted(this.map.meanOf(scene.objects), this.around.stops());
    const { name, edit } = await lamp(kind, scene, this.stage.view().target, value);
    if (await this.editor.run(`insert ${name}`, edit)) this.around.choose([{ kind: kind === 'area' ? 'object' : 'light', name }]);
  }

  /** Lights what a canceled job has left: by an edit that changes nothing, since every job lights all that waits. */
  async lightRest(): Promise<void> {
    const shown = this.around.scene()?.objects.find((one) => !one.hidden);
    if (shown) await this.editor.run('continue', { op: 'show', objects: [shown.name] });
  }

  /** One request for all of it: one step of undo. */
  private async run(what: string, those: { name: string }[], edits: Edit[], isOn = false): Promise<Job | null> {
    return those.length && edits.length ? this.editor.run(`${what} ${some(those)}`, edits, isOn) : null;
  }
}

/** The edits that move what is held. */
function moves({ objects, lights }: Held, by: Matrix4, drag: boolean): Edit[] {
  const moved = objects.map(({ name, transform }): Edit => {
    return { op: 'move', object: name, transform: by.clone().multiply(new Matrix4().fromArray(transform)).toArray(), ...(drag && { drag }) };
  });
  const placed = lights.filter((l) => l.position).map(({ name, position, direction }): Edit => {
    const at = new Vector3(...position!).applyMatrix4(by).toArray();
    const towards = direction && new Vector3(...direction).transformDirection(by);
    const isTurned = towards && towards.distanceTo(new Vector3(...direction).normalize()) > 1e-6;
    return { op: 'move_light', light: name, position: at, ...(isTurned && { direction: towards.toArray() }), ...(drag && { drag }) };
  });
  return [...moved, ...placed];
}
