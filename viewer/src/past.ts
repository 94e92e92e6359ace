// What stood in the scene before the last edit.

import { BufferAttribute, BufferGeometry, Group, Mesh, ShaderMaterial } from 'three';

/** An object of before the edit: with the light of then as its own, out of the picture until it is asked for. */
export function asItWas(group: Group): Group {
  group.visible = false;
  group.matrix.identity();
  group.matrixWorldNeedsUpdate = true;
  for (const child of group.children) {
    const { geometry, material } = child as Mesh<BufferGeometry, ShaderMaterial>;
    const light = new BufferAttribute(geometry.getAttribute('base').array.slice(), 3);
    geometry.setAttribute('light', light);
    geometry.setAttribute('base', light);
    material.uniforms['selected']!.value = 0;
  }
  return group;
}
