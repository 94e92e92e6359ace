// What things stand on.

import { Below } from './below';
import { Box3, Matrix4, Raycaster, Vector3, type Camera, type Group, type Object3D, type Vector2 } from 'three';

/** A point of a surface, and the side of it that is seen. */
export interface Spot {
  point: Vector3;
  normal: Vector3;
}

/** Whether one box may have something below the middle of another. */
const isUnder = ({ min, max }: Box3, other: Box3) =>
  min.x < other.max.x && max.x > other.min.x && min.z < other.max.z && max.z > other.min.z && min.y < (other.min.y + other.max.y) / 2;

/** By how much a box has to rise (below 0: to fall) to stand on what is under its middle and corners; null where nothing is. */
function rise(box: Box3, others: Below[]): number | null {
  let best: number | null = null;
  for (const [u, v] of [[0.5, 0.5], [0.05, 0.05], [0.95, 0.05], [0.05, 0.95], [0.95, 0.95]] as const) {
    // From its middle: what it has sunk into is below that.
    const from = new Vector3(box.min.x + u * (box.max.x - box.min.x), (box.min.y + box.max.y) / 2, box.min.z + v * (box.max.z - box.min.z));
    for (const other of others) {
      const height = other.under(from);
      if (height !== null) best = Math.max(best ?? -Infinity, height - box.min.y);
    }
  }
  return best;
}

/** By how much each of these objects has to rise to stand on what is below it, the others where they come to stand. `place` puts
 * one there. */
export function drops(names: string[], objects: Map<string, Group>, place: (group: Group, by: Matrix4) => void): Map<string, number> {
  const boxes = new Map([...objects].map(([name, group]) => [name, new Box3().setFromObject(group)]));
  const [found, surfaces] = [new Map<string, number>(), new Map<string, Below>()];
  const surface = (name: string) => surfaces.get(name) ?? surfaces.set(name, new Below(objects.get(name)!)).get(name)!;
  for (const name of names.filter((one) => boxes.has(one)).sort((a, b) => boxes.get(a)!.min.y - boxes.get(b)!.min.y)) {
    const box = boxes.get(name)!;
    const others = [...boxes].filter(([other, its]) => other !== name && isUnder(its, box)).map(([other]) => surface(other));
    const by = rise(box, others);
    if (by === null || Math.abs(by) < 1e-4) continue;
    place(objects.get(name)!, new Matrix4().makeTranslation(0, by, 0));
    // Others may come to stand on it.
    const own = surfaces.get(name);
    if (own) own.risen += by;
    box.translate(new Vector3(0, by, 0));
    found.set(name, by);
  }
  return found;
}

/** What is seen at a point of the view (−1 to 1); null where nothing is. */
export function spotAt(at: Vector2, camera: Camera, surfaces: Object3D[]): Spot | null {
  const ray = new Raycaster();
  ray.setFromCamera(at, camera);
  const [hit] = ray.intersectObjects(surfaces, true);
  if (!hit?.face) return null;
  const normal = hit.face.normal.clone().transformDirection(hit.object.matrixWorld);
  if (normal.dot(ray.ray.direction) > 0) normal.negate();
  return { point: hit.point, normal };
}

/** What puts a box onto a surface: its middle over the spot, its side against it. In steps of `grid` along it, if any. */
export function onto(box: Box3, { point, normal }: Spot, grid = 0): Matrix4 {
  const [middle, half] = [box.getCenter(new Vector3()), box.getSize(new Vector3()).multiplyScalar(0.5)];
  const away = Math.abs(normal.x) * half.x + Math.abs(normal.y) * half.y + Math.abs(normal.z) * half.z;
  const to = point.clone();
  if (grid > 0) {
    to.divideScalar(grid).round().multiplyScalar(grid);
    // The grid is along the surface: the spot stays on it.
    to.addScaledVector(normal, point.clone().sub(to).dot(normal));
  }
  return new Matrix4().makeTranslation(to.addScaledVector(normal, away).sub(middle));
}
