// What is looked at, and how: parts of the light, layers, the service's own pictures, exposure, the split.

import { readFrames, type Filter, type Scene } from 'rebake';
import { client, pictures } from './api';
import type { LightMap } from './lightmap';
import { shared } from './material';
import { $, make } from './dom';
import type { Stage } from './stage';

/** Views of one layer are called after it. */
const LAYER = 'layer ';

export class Views {
  current = 'full';
  exposure = 0;
  private request = 0;
  private picture: AbortController | null = null;

  constructor(
    private readonly scene: () => Scene | null,
    private readonly stage: Stage,
    private readonly map: LightMap,
    private readonly attempt: (what: () => Promise<unknown>) => Promise<void>,
    private readonly filter: () => Filter,
  ) {}

  /** Whether the view shows a picture that the service makes. */
  get isPicture(): boolean {
    return ['picture', 'elements', 'error'].includes(this.current);
  }

  /** Whether the view shows the map itself. */
  get isMap(): boolean {
    return this.current === 'full' || this.current === 'map';
  }

  /** Whether the light before the edit is looked at. */
  private get showsBase(): boolean {
    return this.current === 'change' || this.stage.split;
  }

  private get isLayer(): boolean {
    return this.current === 'direct' || this.current === 'indirect' || this.current.startsWith(LAYER);
  }

  /** What the view needs beside the map: layers and the service's own pictures, fetched anew with every version. */
  refresh(): void {
    if (this.current === 'change') {
      shared.scale.value = this.map.changeScale();
      $('legend-low').textContent = `−${shared.scale.value.toPrecision(1)}`;
      $('legend-high').textContent = `+${shared.scale.value.toPrecision(1)}`;
    }
    if (this.isLayer) void this.attempt(() => this.fetchLayer());
    if (this.isPicture) void this.attempt(() => this.fetchPicture());
  }

  /** Offers the scene's layers; leaves the view of one that is gone. */
  offer(scene: Scene | null): void {
    const select = $<HTMLSelectElement>('view');
    const names = scene?.layers.map((layer) => layer.name) ?? [];
    const offered = [...select.options].filter((option) => option.value.startsWith(LAYER));
    if (JSON.stringify(offered.map((option) => option.value.slice(LAYER.length))) !== JSON.stringify(names)) {
      offered.forEach((option) => option.remove());
      select.append(...names.map((name) => make('option', { value: LAYER + name }, `one layer: ${name}`)));
    }
    if (this.current.startsWith(LAYER) && !names.includes(this.current.slice(LAYER.length))) this.set('full');
    select.value = this.current;
  }

  set(next: string): void {
    this.current = next;
    $<HTMLSelectElement>('view').value = next;
    shared.mode.value = { map: 1, change: 2 }[next] ?? 0;
    this.map.showBase(this.showsBase);
    shared.emissive.value = next === 'indirect' || next.startsWith(LAYER) ? 0 : 1;
    this.request++;
    this.picture?.abort();
    $('picture').hidden = true;
    $('legend').hidden = next !== 'change';
    if (!this.isLayer) this.map.showCurrent();
    if (this.scene()) this.refresh();
    this.stage.invalidate();
  }

  expose(stops: number): void {
    this.exposure = Math.max(-6, Math.min(6, stops));
    this.stage.exposure = this.exposure;
    $<HTMLInputElement>('exposure').value = String(this.exposure);
    $('stops').textContent = this.exposure.toFixed(1);
    if (this.isPicture && this.current !== 'error' && this.scene()) this.refresh();
  }

  split(on: boolean): void {
    $<HTMLInputElement>('split').checked = this.stage.split = on;
    $('split-line').hidden = !on;
    this.map.showBase(this.showsBase);
    this.stage.invalidate();
  }

  private async fetchLayer(): Promise<void> {
    const [request, scene, view] = [++this.request, this.scene()!, this.current];
    const name = view.startsWith(LAYER) ? view.slice(LAYER.length) : null;
    const layer = scene.layers.find((layer) => layer.name === name);
    if (name !== null && !layer) return;
    const file = await client.lightMap(scene.id, { format: 'raw', layer: name === null ? view : `"${name}"`, filter: this.filter() });
    if (request !== this.request) return;
    // As bright as it is in the map, not at unit emission.
    this.map.showLayer(readFrames(file), layer?.weight);
    this.stage.invalidate();
  }

  private async fetchPicture(): Promise<void> {
    this.picture?.abort();
    const mine = (this.picture = new AbortController());
    try {
      // A stated error has no noise; light has, and gets better while one looks.
      const [kind, spp] = this.current === 'picture' ? ['full', 16] as const : [this.current, 4] as const;
      const better = pictures(this.scene()!.id, kind, this.stage.view(), this.exposure, spp, mine.signal);
      for await (const { blob, samples } of better) {
        if (this.picture !== mine) return;
        const image = $<HTMLImageElement>('picture');
        URL.revokeObjectURL(image.src);
        image.src = URL.createObjectURL(blob);
        image.dataset['samples'] = samples ?? '';
        image.hidden = false;
      }
    } catch (error) {
      if (!mine.signal.aborted) throw error;
    }
  }
}
