// Light on pages of texels, as `lightMap` of the file's own materials.

import {
  BackSide, BufferAttribute, DataTexture, FrontSide, HalfFloatType, LinearFilter, LinearSRGBColorSpace, Mesh, RGBAFormat,
  type BufferGeometry, type MeshStandardMaterial, type Object3D,
} from 'three';
import { EXRLoader } from 'three/addons/loaders/EXRLoader.js';
import { GLTFLoader } from 'three/addons/loaders/GLTFLoader.js';
import type { Rebake } from './client.js';
import type { Layout } from './three.js';
import { litMaterial, type Held, type LitMesh } from './three-held.js';
import type { Atlas, AtlasObject, Scene, SceneObject } from './types.js';

export class AtlasLight implements Layout {
  private pages: DataTexture[] = [];
  private isStale = true;
  private wake: () => void = () => {};

  constructor(
    private readonly client: Rebake,
    private readonly id: string,
    private readonly held: Held,
    private readonly signal: AbortSignal,
  ) {}

  async build(scene: Scene): Promise<void> {
    const [file, atlas] = await Promise.all([
      this.client.lightMap(this.id, { format: 'glb', layout: 'atlas' }),
      this.client.atlas(this.id),
    ]);
    const gltf = await new GLTFLoader().parseAsync(file, '');
    if (this.signal.aborted) return;
    this.resize(atlas);
    const nodes = new Map(gltf.scene.children.map((node) => [node.userData['name'] ?? node.name, node]));
    const places = new Map(atlas.objects.map((place) => [place.object, place]));
    for (const object of scene.objects) {
      const [node, place] = [nodes.get(object.name), places.get(object.name)];
      this.held.show(object, node && place ? this.meshes(object, node, place) : []);
    }
    this.held.keep(scene.objects);
    this.refresh();
  }

  async follow(changed: (version: number) => void, failed: (error: Error, isOver: boolean) => void): Promise<void> {
    void this.listen();
    while (!this.signal.aborted) {
      if (!this.isStale) await new Promise<void>((wake) => (this.wake = wake));
      if (this.signal.aborted) return;
      this.isStale = false;
      try {
        changed(await this.fetch());
      } catch (error) {
        failed(error as Error, false);
      }
    }
  }

  close(): void {
    this.wake();
    for (const page of this.pages) page.dispose();
  }

  /** Every new version is fetched, unless a newer one is there by then. */
  private async listen(): Promise<void> {
    for await (const { type } of this.client.events(this.id, this.signal)) {
      if (type === 'snapshot' || type === 'reset') this.refresh();
    }
  }

  private refresh(): void {
    this.isStale = true;
    this.wake();
  }

  private async fetch(): Promise<number> {
    const atlas = await this.client.atlas(this.id);
    this.resize(atlas);
    const files = await Promise.all(this.pages.map((_, page) => this.client.atlasPage(this.id, page)));
    if (this.signal.aborted) return 0;
    files.forEach((file, page) => {
      const { data, width, height } = new EXRLoader().setDataType(HalfFloatType).parse(file);
      const texture = this.pages[page]!;
      // A page that has grown has other rectangles on it: they come with the scene.
      if (texture.image.width !== width || texture.image.height !== height) texture.dispose();
      texture.image = { data: data as Uint16Array<ArrayBuffer>, width: width!, height: height! };
      texture.needsUpdate = true;
    });
    return atlas.version;
  }

  /** As many textures as there are pages; black until light comes. Materials keep them. */
  private resize({ pages }: Atlas): void {
    for (const { width, height } of pages.slice(this.pages.length)) {
      const texture = new DataTexture(new Uint16Array(4 * width * height), width, height, RGBAFormat, HalfFloatType);
      texture.colorSpace = LinearSRGBColorSpace;
      texture.magFilter = texture.minFilter = LinearFilter;
      texture.channel = 1;
      this.pages.push(texture);
    }
  }

  private meshes(object: SceneObject, node: Object3D, place: AtlasObject): LitMesh[] {
    const given: Mesh<BufferGeometry>[] = [];
    node.traverse((child) => child instanceof Mesh && given.push(child));
    const sides = place.back ? [place, place.back] : [place];
    const own = this.held.own(object);
    const corners = new Corners(given.map((mesh) => mesh.geometry));
    return sides.flatMap(({ page }, side) => {
      // The file's triangles with coordinates on the page beside their own; where those cannot be told apart (packed
      // positions), the triangles as they were exported.
      const isFound = own.length > 0 && own.every(({ geometry }) => corners.has(geometry));
      const sources = isFound
        ? own.map(({ mesh, geometry }) => ({ material: mesh.material, geometry: corners.give(geometry, side) }))
        : exported(given, side, sides.length).map((mesh) => ({ ...mesh, material: own.length === 1 ? own[0]!.mesh.material : mesh.material }));
      return sources.map(({ material, geometry }) => {
        const lit = litMaterial(material, object.albedo);
        lit.lightMap = this.pages[page]!;
        lit.lightMapIntensity = Math.PI;
        if (sides.length > 1) lit.side = side ? BackSide : FrontSide;
        return new Mesh(geometry, lit);
      });
    });
  }
}

/** The exported triangles of one side. */
function exported(given: Mesh<BufferGeometry>[], side: number, sides: number) {
  const count = given.length / sides;
  return given.slice(side * count, (side + 1) * count).map((mesh) => {
    const geometry = mesh.geometry.clone();
    const corners = geometry.getAttribute('uv1') as BufferAttribute;
    geometry.deleteAttribute('uv');
    geometry.setAttribute('uv1', upright(corners.array as Float32Array));
    // A back is exported as a front that is turned around; here it is drawn as a back.
    if (side) turn(geometry);
    // What shows the light there is a picture of it.
    const material = (mesh.material as MeshStandardMaterial).clone();
    material.emissiveMap = null;
    material.emissive.setScalar(0);
    return { material, geometry };
  });
}

/** Coordinates on a page have their origin top left; textures that are read from data have it bottom left. */
function upright(texcoords: Float32Array): BufferAttribute {
  return new BufferAttribute(texcoords.map((x, i) => (i % 2 ? 1 - x : x)), 2);
}

function turn(geometry: BufferGeometry): void {
  const index = geometry.getIndex()!;
  for (let i = 0; i < index.count; i += 3) {
    const second = index.getX(i + 1);
    index.setX(i + 1, index.getX(i + 2));
    index.setX(i + 2, second);
  }
  const normal = geometry.getAttribute('normal');
  for (let i = 0; i < normal.count; i++) normal.setXYZ(i, -normal.getX(i), -normal.getY(i), -normal.getZ(i));
}

/** Texture coordinates of the corners of exported triangles, by where the corners are. */
class Corners {
  /** By triangle; of triangles that are exported twice, front and back. */
  private readonly sides = new Map<string, Map<string, [number, number]>[]>();

  constructor(geometries: BufferGeometry[]) {
    for (const geometry of geometries) {
      const [position, uv] = [geometry.getAttribute('position'), geometry.getAttribute('uv1')];
      const index = geometry.getIndex()!;
      for (let i = 0; i < index.count; i += 3) {
        const corners = [0, 1, 2].map((k) => index.getX(i + k));
        const keys = corners.map((corner) => keyAt(position, corner));
        const at = new Map(corners.map((corner, k) => [keys[k]!, [uv.getX(corner), 1 - uv.getY(corner)] as [number, number]]));
        const key = keys.sort().join();
        this.sides.set(key, [...(this.sides.get(key) ?? []), at]);
      }
    }
  }

  /** Whether most triangles of a geometry are among them: all but those without an area. */
  has(geometry: BufferGeometry): boolean {
    const [position, index] = [geometry.getAttribute('position'), geometry.index];
    const count = index?.count ?? position.count;
    let found = 0;
    for (let i = 0; i < count; i += 3) {
      const keys = [0, 1, 2].map((k) => keyAt(position, index ? index.getX(i + k) : i + k));
      if (this.sides.has(keys.sort().join())) found += 3;
    }
    return found > 0.8 * count;
  }

  /** A copy of a geometry with a set `uv1` for one side; triangles that were not exported (without an area) get none. */
  give(geometry: BufferGeometry, side: number): BufferGeometry {
    const own = geometry.index ? geometry.toNonIndexed() : geometry.clone();
    const position = own.getAttribute('position');
    const texcoords = new Float32Array(2 * position.count);
    for (let i = 0; i < position.count; i += 3) {
      const keys = [0, 1, 2].map((k) => keyAt(position, i + k));
      const corners = this.sides.get([...keys].sort().join())?.[side];
      keys.forEach((key, k) => texcoords.set(corners?.get(key) ?? [0, 0], 2 * (i + k)));
    }
    own.setAttribute('uv1', new BufferAttribute(texcoords, 2));
    return own;
  }
}

/** Positions are written as they were read, bit for bit. */
const keyAt = (position: { getX(i: number): number; getY(i: number): number; getZ(i: number): number }, i: number) =>
  `${position.getX(i)} ${position.getY(i)} ${position.getZ(i)}`;
