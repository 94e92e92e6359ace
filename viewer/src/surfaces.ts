// What things stand on.

import { Box3, Matrix4, Raycaster, Vector3, type Camera, type Object3D, type Vector2 } from 'three';

/** A point of a surface, and the side of it that is seen. */
export interface Spot {
  point: Vector3;
  normal: Vector3;
}

/** Whether one box may have something below the middle of another. */
export const isUnder = ({ min, max }: Box3, other: Box3) =>
  min.x < other.max.x && max.x > other.min.x && min.z < other.max.z && max.z > other.min.z && min.y < (other.min.y + other.max.y) / 2;

/** By how much a box has to rise (below 0: to fall) to stand on what is under its middle and corners; null where nothing is. */
export function rise(box: Box3, others: Object3D[]): number | null {
  const ray = new Raycaster();
  let best: number | null = null;
  for (const [u, v] of [[0.5, 0.5], [0.05, 0.05], [0.95, 0.05], [0.05, 0.95], [0.95, 0.95]] as const) {
    // From its middle: what it has sunk into is below that.
    const from = new Vector3(box.min.x + u * (box.max.x - box.min.x), (box.min.y + box.max.y) / 2, box.min.z + v * (box.max.z - box.min.z));
    ray.set(from, new Vector3(0, -1, 0));
    const [hit] = ray.intersectObjects(others, true);
    if (hit) best = Math.max(best ?? -Infinity, hit.point.y - box.min.y);
  }
  return best;
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
