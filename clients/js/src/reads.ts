// Vertices that have the light of several elements: where triangles of a file are smaller than light needs.

/** Of each vertex, three elements of its object and their weights. */
export interface Reads {
  elements: ArrayLike<number>;
  weights: ArrayLike<number>;
}

/** A node of three.js. */
interface Node {
  traverse(visit: (child: object) => void): void;
}

interface Child {
  geometry?: { attributes: Record<string, { array: ArrayLike<number> } | undefined> };
}

/** The attributes `_ELEMENTS` and `_WEIGHTS` of an object in a light map's glTF file; none where vertex i is element i. */
export function readsOf(node: Node): Reads | undefined {
  let reads: Reads | undefined;
  node.traverse((child) => {
    const attributes = (child as Child).geometry?.attributes;
    const [elements, weights] = [attributes?.['_elements'], attributes?.['_weights']];
    if (elements && weights) reads = { elements: elements.array, weights: weights.array };
  });
  return reads;
}

/** Light at the vertices of an object, RGB, from that of its elements. */
export function readVertices({ elements, weights }: Reads, light: Float32Array, vertices: Float32Array): void {
  for (let vertex = 0; vertex < vertices.length; vertex += 3) {
    let [r, g, b] = [0, 0, 0];
    for (let k = vertex; k < vertex + 3; k++) {
      const [from, weight] = [3 * elements[k]!, weights[k]!];
      if (weight === 0) continue;
      r += weight * light[from]!;
      g += weight * light[from + 1]!;
      b += weight * light[from + 2]!;
    }
    vertices[vertex] = r;
    vertices[vertex + 1] = g;
    vertices[vertex + 2] = b;
  }
}
