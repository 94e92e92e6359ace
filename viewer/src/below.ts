// What lies below a point: the triangles of a mesh, by where they are seen from above. A ray against every triangle of a
// level, for each of a hundred objects, would take seconds.

import { DoubleSide, Mesh, Vector3, type Object3D } from 'three';

/** A surface as it stands now, seen from above. */
export class Below {
  /** Added to its heights: it has risen since. */
  risen = 0;
  /** Corners of the triangles that a downward ray meets from their fronts, nine numbers each. */
  private readonly corners: number[] = [];
  /** Per cell of a grid over x and z: its triangles. */
  private readonly cells: number[][] = [];
  private readonly side: number;
  private low = [Infinity, Infinity];
  private size = [1, 1];

  constructor(object: Object3D) {
    object.updateWorldMatrix(true, true);
    object.traverse((child) => child instanceof Mesh && this.take(child));
    const count = this.corners.length / 9;
    this.side = Math.max(1, Math.ceil(Math.sqrt(count)));
    let high = [-Infinity, -Infinity];
    for (let k = 0; k < this.corners.length; k += 3) {
      const at = [this.corners[k]!, this.corners[k + 2]!];
      this.low = this.low.map((x, axis) => Math.min(x, at[axis]!));
      high = high.map((x, axis) => Math.max(x, at[axis]!));
    }
    this.size = high.map((x, axis) => Math.max(x - this.low[axis]!, 1e-9));
    for (let t = 0; t < count; t++) {
      const [xs, zs] = [0, 2].map((axis) => [0, 3, 6].map((corner) => this.cell(this.corners[9 * t + corner + axis]!, axis / 2)));
      for (let i = Math.min(...xs!); i <= Math.max(...xs!); i++) {
        for (let j = Math.min(...zs!); j <= Math.max(...zs!); j++) (this.cells[i * this.side + j] ??= []).push(t);
      }
    }
  }

  /** The height of what is met first on the way down from a point; null where nothing is. */
  under({ x, y, z }: Vector3): number | null {
    const { corners, low, size } = this;
    if (x < low[0]! || z < low[1]! || x > low[0]! + size[0]! || z > low[1]! + size[1]!) return null;
    let best: number | null = null;
    for (const t of this.cells[this.cell(x, 0) * this.side + this.cell(z, 1)] ?? []) {
      const [ax, ay, az, bx, by, bz, cx, cy, cz] = corners.slice(9 * t, 9 * t + 9) as [number, number, number, number, number, number, number, number, number];
      const area = (bx - ax) * (cz - az) - (cx - ax) * (bz - az);
      const [v, w] = [((x - ax) * (cz - az) - (cx - ax) * (z - az)) / area, ((bx - ax) * (z - az) - (x - ax) * (bz - az)) / area];
      if (v < 0 || w < 0 || v + w > 1) continue;
      const height = ay + v * (by - ay) + w * (cy - ay) + this.risen;
      if (height <= y && height > (best ?? -Infinity)) best = height;
    }
    return best;
  }

  private cell(at: number, axis: number): number {
    return Math.min(this.side - 1, Math.max(0, Math.floor(((at - this.low[axis]!) / this.size[axis]!) * this.side)));
  }

  private take({ geometry, material, matrixWorld }: Mesh): void {
    const { index, attributes } = geometry;
    const points = attributes['position']!;
    const corner = [new Vector3(), new Vector3(), new Vector3()] as const;
    const isTwoSided = !Array.isArray(material) && material.side === DoubleSide;
    const turned = matrixWorld.determinant() < 0 ? -1 : 1;
    for (let k = 0; k < (index ?? points).count; k += 3) {
      corner.forEach((point, c) => point.fromBufferAttribute(points, index ? index.getX(k + c) : k + c).applyMatrix4(matrixWorld));
      const [a, b, c] = corner;
      // The upward part of its normal.
      const up = turned * ((b.z - a.z) * (c.x - a.x) - (b.x - a.x) * (c.z - a.z));
      if (up > 0 || (isTwoSided && up !== 0)) for (const { x, y, z } of corner) this.corners.push(x, y, z);
    }
  }
}
