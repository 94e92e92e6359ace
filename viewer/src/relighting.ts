// A light's new strength, shown before the service answers: where the light has a layer of its own, the map changes by
// the difference of weights times that layer, which is the same sum that the service makes.

import { apply, reach, readFrames, type Filter, type Light, type Rgb, type Scene, type SceneLayer } from 'rebake';
import { client } from './api';
import type { LightMap } from './lightmap';

export class Relighting {
  /** The layer of the light that is selected, as of a version. */
  private held: { scene: string; name: string; filter: Filter; version: number; values: Float32Array } | null = null;
  /** The map when a slider was touched, and what the layer counted in it. */
  private drag: { base: Float32Array; weight: Rgb; layer: SceneLayer } | null = null;

  /** `filter`: what is done to the map that is shown. Layers that are filtered alike add up to it. */
  constructor(
    private readonly map: LightMap,
    private readonly filter: () => Filter,
  ) {}

  /** Whether a slider of the selected light acts at once, on a map of this version. */
  isReady(version: number): boolean {
    return this.held?.version === version && this.held.filter === this.filter();
  }

  /** Fetches what changed in a light's layer, all of it the first time. */
  async prepare(scene: Scene, light: Light): Promise<void> {
    const layer = own(scene, light);
    if (!layer || this.drag) return;
    const filter = this.filter();
    if (this.held?.scene !== scene.id || this.held.name !== layer.name || this.held.filter !== filter) this.held = null;
    const frames = readFrames(await client.deltas(scene.id, this.held?.version ?? 0, { layer: layer.name, filter }));
    let values = this.held?.values ?? new Float32Array();
    const elements = Math.max(values.length / 3, ...frames.map(reach));
    if (3 * elements > values.length) {
      const larger = new Float32Array(3 * elements);
      larger.set(values);
      values = larger;
    }
    for (const frame of frames) apply(frame, values);
    const version = Math.max(this.held?.version ?? 0, ...frames.map((frame) => frame.version));
    this.held = { scene: scene.id, name: layer.name, filter, version, values };
  }

  /** Shows a strength; answers whether that can be done. `version`: the map's. */
  show(scene: Scene, light: Light, version: number, color: Rgb, intensity: number): boolean {
    const layer = own(scene, light);
    if (!layer || this.held?.name !== layer.name || this.held.scene !== scene.id) return false;
    if (!this.drag) {
      // Everything of one version, or the sum is that of nothing.
      if (scene.version !== version || !this.isReady(version)) return false;
      if (this.held.values.length !== this.map.current.length) return false;
      this.drag = { base: this.map.current.slice(), weight: layer.weight, layer };
    }
    const { base, weight, layer: held } = this.drag;
    const reference = held.lights[0]!.reference;
    const change = color.map((c, k) => (reference[k]! > 0 ? (c * intensity) / reference[k]! : weight[k]!) - weight[k]!);
    this.map.showSum(base, this.held.values, change as Rgb);
    return true;
  }

  /** What the service has computed counts again. */
  rest(): void {
    if (!this.drag) return;
    this.drag = null;
    this.map.showCurrent();
  }
}

/** The layer that holds a light's light alone. */
function own(scene: Scene, light: Light): SceneLayer | undefined {
  return scene.layers.find((layer) => layer.name === light.layer && layer.lights.length === 1);
}
