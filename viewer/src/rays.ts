// What is below something.

import { Box3, Raycaster, Vector3, type Object3D } from 'three';

/** By how much an object has to rise (below 0: to fall) to stand on what is under its middle and corners; null where nothing is. */
export function rise(own: Object3D, others: Object3D[]): number | null {
  const box = new Box3().setFromObject(own);
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
