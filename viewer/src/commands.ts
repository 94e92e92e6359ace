// What can be done with what is selected, and what can be put in.

import { Matrix4 } from 'three';
import type { Job, Light, NewLight, Point, Rgb, Scene, SceneObject } from 'rebake';
import { client } from './api';
import { freeName } from './dom';
import type { Editor } from './editor';
import { lamp, wanted, type LampKind } from './lamps';
import type { LightMap } from './lightmap';
import type { Picked, Stage } from './stage';

interface Around {
  scene(): Scene | null;
  picked(): Picked | null;
  choose(next: Picked | null): void;
  stops(): number;
}

export class Commands {
  constructor(
    private readonly around: Around,
    private readonly editor: Editor,
    private readonly stage: Stage,
    private readonly map: LightMap,
  ) {}

  get object(): SceneObject | undefined {
    const picked = this.around.picked();
    return this.around.scene()?.objects.find((o) => picked?.kind === 'object' && o.name === picked.name);
  }

  /** The light that is selected, or that of the selected object. */
  get light(): Light | undefined {
    const picked = this.around.picked();
    return this.around.scene()?.lights.find((l) => (picked?.kind === 'light' ? l.name === picked.name : l.object === picked?.name));
  }

  async remove(): Promise<void> {
    const { object, light } = this;
    if (object) await this.editor.run(`remove ${object.name}`, { op: 'remove', objects: [object.name] });
    else if (light) await this.editor.run(`remove ${light.name}`, { op: 'remove_light', light: light.name });
  }

  async hide(is = !this.object?.hidden): Promise<void> {
    const { object } = this;
    if (object) await this.editor.run(`${is ? 'hide' : 'show'} ${object.name}`, { op: is ? 'hide' : 'show', objects: [object.name] });
  }

  async move(by: Matrix4): Promise<void> {
    const { object, light } = this;
    if (object) {
      const transform = by.clone().multiply(new Matrix4().fromArray(object.transform)).toArray();
      await this.editor.run(`move ${object.name}`, { op: 'move', object: object.name, transform });
    } else if (light?.position) {
      const e = by.elements;
      const position = light.position.map((x, k) => x + e[12 + k]!);
      await this.editor.run(`move ${light.name}`, { op: 'move_light', light: light.name, position });
    }
  }

  async aim(direction: Point): Promise<void> {
    const { light } = this;
    if (light) await this.editor.run(`turn ${light.name}`, { op: 'move_light', light: light.name, direction });
  }

  /** Down onto what is below it, or up out of it. */
  async toFloor(): Promise<void> {
    const { object } = this;
    const by = object && this.stage.dropOf(object.name);
    if (by != null && Math.abs(by) > 1e-4) await this.move(new Matrix4().makeTranslation(0, by, 0));
  }

  async paint(albedo: Rgb): Promise<void> {
    const { object } = this;
    if (object) await this.editor.run(`repaint ${object.name}`, { op: 'material', object: object.name, albedo });
  }

  relight(light: Light, color: Rgb, intensity: number): Promise<Job | null> {
    return this.editor.run(`relight ${light.name}`, { op: 'relight', lights: [{ light: light.name, color, intensity }] });
  }

  /** Another one beside it. Pictures stay with the file: a copy has the mean colour of its materials. */
  async duplicate(): Promise<void> {
    const { object, light } = this;
    const scene = this.around.scene();
    if (!scene) return;
    const taken = [...scene.objects, ...scene.lights].map((one) => one.name);
    if (object && !object.hidden) {
      const name = freeName(object.name, taken);
      const { asset } = await client.asset(new Blob([await client.objectMesh(scene.id, object.name)]));
      const { min, max } = object.bounds;
      const transform = new Matrix4().makeTranslation((max[0] - min[0]) * 1.1 + 0.05, 0, 0).toArray();
      if (await this.editor.run(`duplicate ${object.name}`, { op: 'insert', asset, name, transform })) this.around.choose({ kind: 'object', name });
    } else if (light?.position && !light.object) {
      const name = freeName(light.name, taken);
      const { kind, color, intensity, position: [x, y, z], direction } = light;
      const copy = { kind, color, intensity, position: [x + 0.5, y, z], ...(kind === 'spot' && { direction }) } as NewLight;
      if (await this.editor.run(`duplicate ${light.name}`, { op: 'insert_light', name, light: copy })) this.around.choose({ kind: 'light', name });
    }
  }

  /** Puts something from the library onto the surface in the middle of the view. */
  async insert(asset: string, wanted: string): Promise<void> {
    const scene = this.around.scene();
    if (!scene) return;
    const name = freeName(wanted, [...scene.objects, ...scene.lights].map((one) => one.name));
    const transform = new Matrix4().makeTranslation(...this.stage.ahead()).toArray();
    await this.editor.run(`insert ${name}`, { op: 'insert', asset, name, transform });
  }

  async addLight(kind: LampKind): Promise<void> {
    const scene = this.around.scene();
    if (!scene) return;
    const value = wanted(this.map.meanOf(scene.objects), this.around.stops());
    const { name, edit } = await lamp(kind, scene, this.stage.view().target, value);
    if (await this.editor.run(`insert ${name}`, edit)) this.around.choose({ kind: kind === 'area' ? 'object' : 'light', name });
  }

  /** Lights what a canceled job has left: by an edit that changes nothing, since every job lights all that waits. */
  async lightRest(): Promise<void> {
    const shown = this.around.scene()?.objects.find((one) => !one.hidden);
    if (shown) await this.editor.run('continue', { op: 'show', objects: [shown.name] });
  }
}
