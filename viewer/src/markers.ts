// Lights that stand at a place, as little balls of their colour.

import { Color, Matrix4, Mesh, MeshBasicMaterial, SphereGeometry, Vector3, type Object3D } from 'three';
import type { Light, Point } from 'rebake';
import type { Picked } from './selection';

export class Markers {
  private readonly all = new Map<string, Mesh<SphereGeometry, MeshBasicMaterial>>();
  /** Where they stood when some of them were taken hold of. */
  private grabbed = new Map<string, Vector3>();

  constructor(private readonly parent: Object3D) {}

  get meshes(): Mesh[] {
    return [...this.all.values()];
  }

  get(name: string): Mesh | undefined {
    return this.all.get(name);
  }

  show(lights: Light[], radius: number): void {
    for (const marker of this.all.values()) {
      this.parent.remove(marker);
      marker.geometry.dispose();
      marker.material.dispose();
    }
    this.all.clear();
    for (const light of lights) {
      if (!light.position) continue;
      const strongest = Math.max(...light.color, 1e-6);
      const color = new Color().setRGB(...(light.color.map((c) => c / strongest) as Point));
      const marker = new Mesh(new SphereGeometry(radius, 16, 12), new MeshBasicMaterial({ color, toneMapped: false }));
      marker.position.fromArray(light.position);
      marker.userData = { picked: { kind: 'light', name: light.name } satisfies Picked, at: marker.position.clone() };
      this.all.set(light.name, marker);
      this.parent.add(marker);
    }
  }

  /** What moves by something moves from here, wherever it is shown meanwhile. */
  grab(): void {
    this.grabbed = new Map([...this.all].map(([name, marker]) => [name, marker.position.clone()]));
  }

  /** Shows one by so much beside where it was taken hold of. */
  move(name: string, by: Matrix4): void {
    const marker = this.all.get(name);
    if (marker) marker.position.copy(this.grabbed.get(name) ?? (marker.userData['at'] as Vector3)).applyMatrix4(by);
  }

  /** Shows one where it stands. */
  settleBack(name: string): void {
    const marker = this.all.get(name);
    if (marker) marker.position.copy(marker.userData['at'] as Vector3);
  }
}
