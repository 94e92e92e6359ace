// Live light maps on three.js scenes.

import { Light as ThreeLight, Matrix4, Object3D } from 'three';
import { AtlasLight } from './three-atlas.js';
import { Held } from './three-held.js';
import { VertexLight } from './three-vertices.js';
import type { Rebake } from './client.js';
import type { Scene } from './types.js';

/** What `GLTFLoader` gives, or its scene alone. With the former, objects are found by the nodes of the file, else by name. */
export type Loaded = Object3D | { scene: Object3D; parser?: { associations: Map<unknown, { nodes?: number }> } };

export interface LightMapOptions {
  /** A light map on pages of texels, which keeps textures, or at vertices. The former where the scene was uploaded with one. */
  layout?: 'atlas' | 'vertices';
  /** Called after every change that can be seen: draw a frame. */
  onChange?: (version: number) => void;
  /** Something failed for good, or (with `isOver` false) for now. */
  onError?: (error: Error, isOver: boolean) => void;
  /** Follow on this thread: where workers may not be loaded. */
  worker?: boolean | (() => Worker);
}

export interface LiveLightMap {
  /** Once the first light is shown. Rejects where it cannot be. */
  readonly ready: Promise<void>;
  /** Version that is shown. */
  readonly version: number;
  /** The scene as it is now: objects, lights, cameras. Null until it is known. */
  readonly scene: Scene | null;
  /** Ends it, and puts back what was there. */
  close(): void;
}

/** What puts light on objects. */
export interface Layout {
  /** Meshes as the scene has them now. */
  build(scene: Scene): Promise<void>;
  /** Keeps light up to date until closed. */
  follow(changed: (version: number) => void, failed: (error: Error, isOver: boolean) => void): Promise<void>;
  close(): void;
}

/**
 * Puts the light map of a scene on the glTF that it was made of, and keeps it up to date: light as it gets better, and
 * edits, whoever makes them (objects that come, go, move and are repainted; lights).
 *
 * Light map values are irradiance / π, three.js takes irradiance: hence `lightMapIntensity` = π, and what is shown is
 * albedo × value. Where the map holds all light (`mode` full) the lights of the file are switched off.
 */
export function attachLightMap(loaded: Loaded, client: Rebake, scene: string, options: LightMapOptions = {}): LiveLightMap {
  return new Attached(loaded, client, scene, options);
}

class Attached implements LiveLightMap {
  readonly ready: Promise<void>;
  version = 0;
  scene: Scene | null = null;

  private readonly stop = new AbortController();
  private readonly held: Held;
  private layout: Layout | null = null;
  private readonly switchedOff: ThreeLight[] = [];
  /** Refreshes come one after the other; one more where something has changed meanwhile. */
  private refreshing: Promise<void> | null = null;
  private isStale = false;

  constructor(
    loaded: Loaded,
    private readonly client: Rebake,
    private readonly id: string,
    private readonly options: LightMapOptions,
  ) {
    this.held = new Held(loaded instanceof Object3D ? { scene: loaded } : loaded);
    this.ready = this.start();
    this.ready.catch((error) => this.stop.signal.aborted || options.onError?.(error, true));
  }

  close(): void {
    this.stop.abort();
    this.layout?.close();
    this.held.restore();
    for (const light of this.switchedOff) light.visible = true;
  }

  private async start(): Promise<void> {
    const { client, id, held, options } = this;
    const { signal } = this.stop;
    const scene = await client.prepared(id);
    if (signal.aborted) return;
    const asAtlas = (options.layout ?? (scene.texels_per_metre ? 'atlas' : 'vertices')) === 'atlas';
    this.layout = asAtlas ? new AtlasLight(client, id, held, signal) : new VertexLight(client, id, held, signal, options.worker ?? true);
    this.scene = scene;
    if (scene.mode === 'full') this.switchOff();
    await this.layout.build(scene);
    this.look();
    void this.listen();
    await new Promise<void>((done, failed) => {
      const changed = (version: number) => {
        this.version = version;
        options.onChange?.(version);
        // Light of a scene that nothing has lit yet is dark, and all there is.
        done();
      };
      const broken = (error: Error, isOver: boolean) => {
        if (isOver) failed(error);
        if (!signal.aborted) options.onError?.(error, isOver);
      };
      void this.layout!.follow(changed, broken).catch((error) => broken(error, true));
    });
  }

  private switchOff(): void {
    this.held.root.traverse((child) => {
      if (!(child instanceof ThreeLight) || !child.visible) return;
      child.visible = false;
      this.switchedOff.push(child);
    });
  }

  /** Hears of edits: the scene is looked at again where its elements, objects or lights have changed. */
  private async listen(): Promise<void> {
    for await (const { type, data } of this.client.events(this.id, this.stop.signal)) {
      const isNew = type === 'reset' || (type === 'scene' && data.what === 'edited') || data.elements_version > this.scene!.elements_version;
      if (isNew) this.refresh();
    }
  }

  private refresh(): void {
    this.isStale = true;
    this.refreshing ??= this.catchUp().finally(() => (this.refreshing = null));
  }

  private async catchUp(): Promise<void> {
    while (this.isStale && !this.stop.signal.aborted) {
      this.isStale = false;
      try {
        const scene = await this.client.scene(this.id);
        if (this.stop.signal.aborted) return;
        const isSame = this.scene && shape(scene) === shape(this.scene);
        if (!isSame) await this.layout!.build(scene);
        this.scene = scene;
        this.look();
        this.options.onChange?.(this.version);
      } catch (error) {
        if (!this.stop.signal.aborted) this.options.onError?.(error as Error, false);
      }
    }
  }

  /** Places, albedo and emission as edits have left them. */
  private look(): void {
    const scene = this.scene!;
    for (const object of scene.objects) {
      const lights = scene.lights.filter((light) => light.object === object.name);
      this.held.place(object, new Matrix4().fromArray(object.transform));
      this.held.paint(object, lights);
    }
  }
}

/** What meshes depend on. */
const shape = (scene: Scene) => JSON.stringify(scene.objects.map((o) => [o.name, o.elements, o.bounds, o.transform, o.hidden]));
