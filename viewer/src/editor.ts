// Edits with their inverses: what undo and redo send.

import { Color, Matrix4, Mesh, MeshStandardMaterial, type Group, type ShaderMaterial } from 'three';
import { GLTFExporter } from 'three/examples/jsm/exporters/GLTFExporter.js';
import type { Edit, Job, Light, NewLight, Point, Rgb, Scene, SceneObject } from 'rebake';
import { client, type View } from './api';

const IDENTITY = new Matrix4().toArray();

/** An edit, and what takes it back. */
interface Step {
  label: string;
  forth: Edit[];
  back: Edit[];
}

export class Editor {
  private done: Step[] = [];
  private undone: Step[] = [];

  constructor(
    private readonly scene: () => Scene,
    private readonly view: () => View,
    /** An edit is about to be sent; another was accepted. */
    private readonly events: { before(): void; accepted(job: Job, label: string): void; changed(): void },
  ) {}

  get canUndo(): string | undefined {
    return this.done.at(-1)?.label;
  }

  get canRedo(): string | undefined {
    return this.undone.at(-1)?.label;
  }

  clear(): void {
    this.done = [];
    this.undone = [];
    this.events.changed();
  }

  async undo(): Promise<void> {
    const step = this.done.at(-1);
    if (!step) return;
    await this.send(step.back, `undo: ${step.label}`);
    this.undone.push(this.done.pop()!);
    this.events.changed();
  }

  async redo(): Promise<void> {
    const step = this.undone.at(-1);
    if (!step) return;
    await this.send(step.forth, `redo: ${step.label}`);
    this.done.push(this.undone.pop()!);
    this.events.changed();
  }

  /** Takes an object out. Its geometry is kept by the service as an asset, so that it can come back. */
  async remove(object: SceneObject, group: Group): Promise<void> {
    const asset = (await client.asset(await toGlb(group))).asset;
    await this.run({
      label: `remove ${object.name}`,
      forth: [{ op: 'remove', objects: [object.name] }],
      back: [{ op: 'insert', asset, name: object.name, transform: IDENTITY }],
    });
  }

  async insert(asset: string, wanted: string, at: Point): Promise<void> {
    const taken = new Set(this.scene().objects.map((o) => o.name));
    let name = wanted;
    for (let n = 2; taken.has(name); n++) name = `${wanted}-${n}`;
    const transform = new Matrix4().makeTranslation(...at).toArray();
    await this.run({
      label: `insert ${name}`,
      forth: [{ op: 'insert', asset, name, transform }],
      back: [{ op: 'remove', objects: [name] }],
    });
  }

  /** Moves an object by a world-space matrix. */
  async move(object: SceneObject, delta: Matrix4): Promise<void> {
    const transform = delta.clone().multiply(new Matrix4().fromArray(object.transform)).toArray();
    await this.run({
      label: `move ${object.name}`,
      forth: [{ op: 'move', object: object.name, transform }],
      back: [{ op: 'move', object: object.name, transform: object.transform }],
    });
  }

  async paint(object: SceneObject, albedo: Rgb): Promise<void> {
    await this.run({
      label: `repaint ${object.name}`,
      forth: [{ op: 'material', object: object.name, albedo }],
      back: [{ op: 'material', object: object.name, albedo: object.albedo }],
    });
  }

  /** Changes a light; steps of one drag of a slider (`from` is the light before it) are one step of undo. */
  async relight(from: Light, color: Rgb, intensity: number): Promise<void> {
    const set = (color: Rgb, intensity: number): Edit[] => [
      { op: 'relight', lights: [{ light: from.name, color, intensity }] },
    ];
    const label = `light ${from.name}`;
    const step = { label, forth: set(color, intensity), back: set(from.color, from.intensity) };
    const last = this.done.at(-1);
    const goesOn = last?.label === label && JSON.stringify(last.back) === JSON.stringify(step.back);
    await this.send(step.forth, label);
    if (goesOn) this.done.pop();
    this.push(step);
  }

  async moveLight(light: Light, to: Point): Promise<void> {
    const set = (position: Point): Edit[] => [{ op: 'move_light', light: light.name, position }];
    await this.run({ label: `move ${light.name}`, forth: set(to), back: set(light.position!) });
  }

  async addLight(position: Point, intensity: number): Promise<string> {
    const taken = new Set(this.scene().lights.map((l) => l.name));
    let n = 1;
    while (taken.has(`light-${n}`)) n++;
    const name = `light-${n}`;
    await this.run({
      label: `add ${name}`,
      forth: [{ op: 'insert_light', name, light: { kind: 'point', position, color: [1, 0.95, 0.85], intensity } }],
      back: [{ op: 'remove_light', light: name }],
    });
    return name;
  }

  /** Takes a light away. What the service does not tell of a light (cone, range) does not come back with undo. */
  async removeLight(light: Light): Promise<void> {
    const { kind, color, intensity, position, direction } = light;
    await this.run({
      label: `remove ${light.name}`,
      forth: [{ op: 'remove_light', light: light.name }],
      back: [{ op: 'insert_light', name: light.name, light: { kind, color, intensity, position, direction } as NewLight }],
    });
  }

  private async run(step: Step): Promise<void> {
    await this.send(step.forth, step.label);
    this.push(step);
  }

  private push(step: Step): void {
    this.done.push(step);
    this.undone = [];
    this.events.changed();
  }

  private async send(edits: Edit[], label: string): Promise<void> {
    this.events.before();
    this.events.accepted(await client.edit(this.scene().id, edits, { focus: this.view() }), label);
  }
}

/** An object's world-space geometry and materials as a file. */
async function toGlb(group: Group): Promise<Blob> {
  const copy = group.clone();
  copy.traverse((child) => {
    if (!(child instanceof Mesh)) return;
    const { uniforms, side } = child.material as ShaderMaterial;
    const color = (name: string) => new Color().setRGB(...(uniforms[name]!.value.toArray() as Rgb));
    const emission = color('emission');
    const strength = Math.max(emission.r, emission.g, emission.b, 1);
    const material = new MeshStandardMaterial({ color: color('albedo'), roughness: 1, metalness: 0, side });
    material.opacity = uniforms['opacity']!.value;
    material.transparent = material.opacity < 1;
    material.emissive.copy(emission.multiplyScalar(1 / strength));
    material.emissiveIntensity = strength;
    const geometry = child.geometry.clone();
    geometry.deleteAttribute('light');
    geometry.deleteAttribute('base');
    child.geometry = geometry;
    child.material = material;
    child.matrix.decompose(child.position, child.quaternion, child.scale);
  });
  const file = await new GLTFExporter().parseAsync(copy, { binary: true });
  return new Blob([file as ArrayBuffer]);
}
