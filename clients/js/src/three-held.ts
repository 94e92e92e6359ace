// The nodes of a loaded glTF that are objects of a scene, and what stands in for their own meshes.

import { BufferGeometry, Color, Group, Matrix4, Mesh, MeshStandardMaterial, Object3D, type Material } from 'three';
import type { Light, SceneObject } from './types.js';

/** A mesh that shows light, the same for every layout of the map. */
export type LitMesh = Mesh<BufferGeometry, MeshStandardMaterial>;

interface Entry {
  node: Object3D;
  /** It was inserted by an edit: nothing of it is in the file. */
  isNew: boolean;
  /** The file's own meshes, which draw nothing while there is a stand-in. */
  own: { mesh: Mesh; geometry: BufferGeometry }[];
  place: Matrix4;
  standIn: Group;
  /** Albedo when it was first seen: what is another one by now has been repainted. */
  albedo: string | null;
}

const NOTHING = new BufferGeometry();

export class Held {
  readonly root: Object3D;
  private readonly entries = new Map<string, Entry>();
  private readonly byNode = new Map<number, Object3D>();
  private readonly byName = new Map<string, Object3D>();

  constructor({ scene, parser }: { scene: Object3D; parser?: { associations: Map<unknown, { nodes?: number }> } }) {
    this.root = scene;
    scene.traverse((child) => {
      const node = parser?.associations.get(child)?.nodes;
      if (node !== undefined && !this.byNode.has(node)) this.byNode.set(node, child);
      // The loader changes names that its animations could not address, and keeps those of nodes.
      const name: unknown = child.userData['name'] ?? child.name;
      if (typeof name === 'string' && name && !this.byName.has(name)) this.byName.set(name, child);
    });
  }

  /** The file's own meshes of an object. */
  own(object: SceneObject): { mesh: Mesh; geometry: BufferGeometry }[] {
    return this.entry(object).own;
  }

  /** From world space, as the service has it, into an object's own. */
  fromWorld(object: SceneObject): Matrix4 {
    const { node } = this.entry(object);
    node.updateWorldMatrix(true, false);
    this.root.updateWorldMatrix(true, false);
    return node.matrixWorld.clone().invert().multiply(this.root.matrixWorld);
  }

  /** Shows meshes in place of an object's own; those that it showed before are given back. */
  show(object: SceneObject, meshes: LitMesh[]): void {
    const entry = this.entry(object);
    for (const { mesh } of entry.own) mesh.geometry = NOTHING;
    dispose(entry.standIn);
    entry.standIn.clear();
    if (meshes.length) entry.standIn.add(...meshes);
  }

  /** Objects that are no more, or hidden, show nothing. */
  keep(objects: SceneObject[]): void {
    const names = new Set(objects.map((object) => object.name));
    for (const [name, entry] of this.entries) {
      if (names.has(name)) continue;
      for (const { mesh } of entry.own) mesh.geometry = NOTHING;
      dispose(entry.standIn);
      entry.standIn.clear();
      if (!entry.isNew) continue;
      entry.node.removeFromParent();
      this.entries.delete(name);
    }
  }

  /** Puts an object where the scene has it. */
  place(object: SceneObject, world: Matrix4): void {
    const { node, isNew } = this.entry(object);
    const parent = node.parent ?? this.root;
    parent.updateWorldMatrix(true, false);
    this.root.updateWorldMatrix(true, false);
    const local = parent.matrixWorld.clone().invert().multiply(this.root.matrixWorld).multiply(world);
    node.updateMatrix();
    const isThere = node.matrix.elements.every((x, i) => Math.abs(x - local.elements[i]!) < 1e-5 * (1 + Math.abs(x)));
    if (isThere && !isNew) return;
    local.decompose(node.position, node.quaternion, node.scale);
    node.updateMatrixWorld(true);
  }

  /** Albedo of a repaint, and strength of a lamp, where an object has one material. */
  paint(object: SceneObject, lights: Light[]): void {
    const entry = this.entry(object);
    const albedo = JSON.stringify(object.albedo);
    entry.albedo ??= albedo;
    const materials = new Set(entry.standIn.children.map((child) => (child as LitMesh).material));
    if (materials.size !== 1) return;
    const [material] = materials;
    if (entry.albedo !== albedo) {
      material!.map = null;
      material!.color = new Color().setRGB(...object.albedo);
      material!.needsUpdate = true;
    }
    const [light] = lights;
    if (lights.length > 1 || material!.emissiveMap) return;
    const strength = light ? light.color.map((c) => c * light.intensity) : [0, 0, 0];
    const most = Math.max(...strength, 1e-12);
    material!.emissive = new Color().setRGB(strength[0]! / most, strength[1]! / most, strength[2]! / most);
    material!.emissiveIntensity = light ? most : 0;
  }

  /** The file as it was loaded. */
  restore(): void {
    for (const { node, own, standIn, place, isNew } of this.entries.values()) {
      for (const { mesh, geometry } of own) mesh.geometry = geometry;
      dispose(standIn);
      standIn.removeFromParent();
      if (isNew) node.removeFromParent();
      else place.decompose(node.position, node.quaternion, node.scale);
    }
    this.entries.clear();
  }

  private entry(object: SceneObject): Entry {
    const known = this.entries.get(object.name);
    if (known) return known;
    const found = (object.node != null ? this.byNode.get(object.node) : undefined) ?? this.byName.get(object.name);
    const node = found ?? new Group();
    if (!found) {
      node.name = object.name;
      this.root.add(node);
    }
    // Meshes of a node with several materials are its children, and no nodes of their own.
    const isOwn = (child: Object3D): child is Mesh =>
      child instanceof Mesh && (child === node || (child.userData['name'] === undefined && ![...this.byNode.values()].includes(child)));
    const own = [node, ...node.children].filter(isOwn).map((mesh) => ({ mesh, geometry: mesh.geometry as BufferGeometry }));
    const standIn = new Group();
    standIn.name = 'light map';
    node.add(standIn);
    node.updateMatrix();
    const entry = { node, isNew: !found, own, place: node.matrix.clone(), standIn, albedo: null };
    this.entries.set(object.name, entry);
    return entry;
  }
}

function dispose(group: Group): void {
  for (const child of group.children as LitMesh[]) {
    child.geometry.dispose();
    child.material.dispose();
  }
}

/** A material of the file, as the base of one with light; what has none of three.js's lights becomes one that has. */
export function litMaterial(from: Material | Material[] | undefined, albedo: readonly number[]): MeshStandardMaterial {
  const first = Array.isArray(from) ? from[0] : from;
  if (first instanceof MeshStandardMaterial) return first.clone();
  return new MeshStandardMaterial({ color: new Color().setRGB(albedo[0]!, albedo[1]!, albedo[2]!), roughness: 1, metalness: 0 });
}
