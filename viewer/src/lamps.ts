// New lights, about as strong as what is there, so that a lamp neither whites out a room nor is lost in it.

import { Mesh, MeshStandardMaterial, PlaneGeometry } from 'three';
import { GLTFExporter } from 'three/examples/jsm/exporters/GLTFExporter.js';
import type { Edit, Point, Rgb, Scene } from 'rebake';
import { client } from './api';
import { freeName } from './dom';

export type LampKind = 'point' | 'spot' | 'directional' | 'area' | 'sky';

const WARM: Rgb = [1, 0.9, 0.75];

/** What a new light should add to the map where it falls: half of what is there, or a mean picture where it is dark. */
export function wanted(meanLight: number, stops: number): number {
  return meanLight > 1e-4 ? meanLight / 2 : 0.5 * 2 ** -stops;
}

/** Shortest side of what objects fill, and their middle. */
function room(scene: Scene): { size: number; middle: Point } {
  const side = (k: number) => {
    const low = Math.min(...scene.objects.map((o) => o.bounds.min[k]!));
    const high = Math.max(...scene.objects.map((o) => o.bounds.max[k]!));
    return scene.objects.length ? [low, high] as const : [0, 1] as const;
  };
  const sides = [0, 1, 2].map(side);
  const sizes = sides.map(([low, high]) => high - low).filter((size) => size > 0);
  return { size: Math.min(...sizes, 1e6), middle: sides.map(([low, high]) => (low + high) / 2) as Point };
}

/** The edit that adds a light of some kind above a point, and its name. `value`: what it should add to the map. */
export async function lamp(kind: LampKind, scene: Scene, at: Point, value: number): Promise<{ name: string; edit: Edit }> {
  const taken = [...scene.objects, ...scene.lights].map((one) => one.name);
  const { size } = room(scene);
  const distance = size / 2;
  const above: Point = [at[0], at[1] + size / 6, at[2]];
  if (kind === 'sky') return { name: 'environment', edit: { op: 'sky', radiance: [value, value, value] } };
  const name = freeName(`${kind}-1`, taken);
  if (kind === 'area') {
    const side = size / 8;
    // A patch of area A and radiance L is seen from a distance d under A / d²: the map gets L A / (π d²).
    const radiance = (value * Math.PI * distance ** 2) / side ** 2;
    const { asset } = await client.asset(await patch(side, radiance));
    return { name, edit: { op: 'insert', asset, name, transform: [1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, ...above, 1] } };
  }
  // Irradiance is candela / d², or lux; the map has it over π.
  const intensity = kind === 'directional' ? value * Math.PI : value * Math.PI * distance ** 2;
  const down: Point = [0, -1, 0];
  if (kind === 'point') return { name, edit: { op: 'insert_light', name, light: { kind, position: above, color: WARM, intensity } } };
  if (kind === 'spot') {
    const cone = { inner_cone_angle: 0.4, outer_cone_angle: 0.7 };
    return { name, edit: { op: 'insert_light', name, light: { kind, position: above, direction: down, color: WARM, intensity, ...cone } } };
  }
  const sun = { kind, direction: [-0.4, -0.8, -0.45], color: [1, 0.97, 0.92], intensity, angle: 0.0093 } as const;
  return { name, edit: { op: 'insert_light', name, light: { ...sun, direction: [...sun.direction], color: [...sun.color] } } };
}

/** A square that shines down, as a file. */
async function patch(side: number, radiance: number): Promise<Blob> {
  const material = new MeshStandardMaterial({ color: 0, roughness: 1, metalness: 0 });
  material.emissive.setRGB(...WARM);
  material.emissiveIntensity = radiance;
  const mesh = new Mesh(new PlaneGeometry(side, side).rotateX(Math.PI / 2), material);
  mesh.name = 'area';
  return new Blob([(await new GLTFExporter().parseAsync(mesh, { binary: true })) as ArrayBuffer]);
}
