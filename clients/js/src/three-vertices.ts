// Light at the vertices of the subdivided mesh.

import { BufferAttribute, DynamicDrawUsage, Mesh, type MeshStandardMaterial } from 'three';
import { GLTFLoader } from 'three/addons/loaders/GLTFLoader.js';
import { ElementMap, type Frame } from './frames.js';
import { makeWorker, streamInWorker } from './in-worker.js';
import { readVertices, readsOf, type Reads } from './reads.js';
import type { Rebake } from './client.js';
import type { StreamEvent } from './stream.js';
import type { Layout } from './three.js';
import type { Held, LitMesh } from './three-held.js';
import type { Scene } from './types.js';
import type { FromWorker } from './worker.js';

/** As pages of an atlas come: to look at. */
const FILTERED = { filter: 'statistical' } as const;

/** The light of one object: a look into the map, or a mean of what is there where vertices share elements. */
interface Window {
  first: number;
  count: number;
  light: BufferAttribute;
  reads: Reads | undefined;
}

export class VertexLight implements Layout {
  private readonly map = new ElementMap();
  private windows: Window[] = [];
  private scene: Scene | null = null;
  private worker: Worker | null = null;

  constructor(
    private readonly client: Rebake,
    private readonly id: string,
    private readonly held: Held,
    private readonly signal: AbortSignal,
    private readonly inWorker: boolean | (() => Worker),
  ) {}

  async build(scene: Scene): Promise<void> {
    const file = await this.client.lightMap(this.id, { format: 'glb' });
    const gltf = await new GLTFLoader().parseAsync(file, '');
    if (this.signal.aborted) return;
    this.scene = scene;
    this.map.grow(scene.elements);
    this.windows = [];
    const nodes = new Map(gltf.scene.children.map((node) => [node.userData['name'] ?? node.name, node]));
    for (const object of scene.objects) {
      const node = nodes.get(object.name);
      const meshes: LitMesh[] = [];
      const { first, count } = object.elements;
      const values = this.map.values.subarray(3 * first, 3 * (first + count));
      const reads = node && readsOf(node);
      const light = new BufferAttribute(reads ? new Float32Array(reads.elements.length) : values, 3).setUsage(DynamicDrawUsage);
      if (reads) readVertices(reads, values, light.array as Float32Array);
      node?.updateMatrixWorld(true);
      node?.traverse((child) => {
        if (!(child instanceof Mesh)) return;
        const mesh = child.clone(false) as LitMesh;
        for (const unused of ['color', '_elements', '_weights']) mesh.geometry.deleteAttribute(unused);
        mesh.geometry.setAttribute('light', light);
        mesh.material = lit(mesh.material);
        mesh.matrixAutoUpdate = false;
        mesh.matrix.copy(this.held.fromWorld(object).multiply(child.matrixWorld));
        meshes.push(mesh);
      });
      this.windows.push({ first, count, light, reads });
      this.held.show(object, meshes);
    }
    this.held.keep(scene.objects);
  }

  async follow(changed: (version: number) => void, failed: (error: Error, isOver: boolean) => void): Promise<void> {
    const heard = (event: FromWorker | StreamEvent) => {
      if (event.type === 'snapshot') void this.take(event.frames).then(() => changed(event.version), (error) => failed(error, false));
      else if (event.type === 'offline') failed(new Error(event.why), false);
      else if (event.type === 'gone') failed(new Error('The service has no such scene.'), true);
      else if (event.type === 'failed') failed(new Error(event.why), true);
    };
    if (this.inWorker && typeof Worker !== 'undefined') {
      this.worker = this.inWorker === true ? makeWorker() : this.inWorker();
      streamInWorker(this.worker, this.client, this.id, heard, FILTERED);
      return;
    }
    for await (const event of this.client.follow(this.id, { ...FILTERED, signal: this.signal })) heard(event);
  }

  close(): void {
    this.worker?.terminate();
  }

  private async take(frames: Frame[]): Promise<void> {
    const before = this.map.values;
    const ranges = this.map.apply(frames);
    // The array was replaced: attributes have to look into the new one.
    if (this.map.values !== before) return this.build(this.scene!);
    for (const { first, count, light, reads } of this.windows) {
      let isTouched = false;
      for (const [from, length] of ranges) {
        const [low, high] = [Math.max(first, from), Math.min(first + count, from + length)];
        if (low >= high) continue;
        isTouched = true;
        if (!reads) mark(light, 3 * (low - first), 3 * (high - low));
      }
      if (!reads || !isTouched) continue;
      readVertices(reads, this.map.values.subarray(3 * first, 3 * (first + count)), light.array as Float32Array);
      light.needsUpdate = true;
    }
  }
}

/** Thousands of little uploads cost more than one that is too large. */
function mark(light: BufferAttribute, from: number, count: number): void {
  if (light.updateRanges.length < 64) light.addUpdateRange(from, count);
  else {
    light.clearUpdateRanges();
    light.addUpdateRange(0, light.array.length);
  }
  light.needsUpdate = true;
}

/** A material that takes its irradiance from the attribute `light`, times π, beside other lights. */
function lit(from: MeshStandardMaterial): MeshStandardMaterial {
  const material = from.clone();
  material.vertexColors = false;
  material.onBeforeCompile = (shader) => {
    shader.vertexShader = `attribute vec3 light;\nvarying vec3 vLight;\n${shader.vertexShader}`.replace(
      '#include <begin_vertex>',
      '#include <begin_vertex>\nvLight = light;',
    );
    shader.fragmentShader = `varying vec3 vLight;\n${shader.fragmentShader}`.replace(
      '#include <lights_fragment_maps>',
      '#include <lights_fragment_maps>\nirradiance += PI * vLight;',
    );
  };
  material.customProgramCacheKey = () => 'rebake-vertices';
  return material;
}
