// The gizmo at what is selected, which moves, turns and scales it as one about its middle.

import { Matrix4, Object3D, type Camera, type Scene, type Vector3 } from 'three';
import { TransformControls } from 'three/examples/jsm/controls/TransformControls.js';

export interface Grips {
  changed(): void;
  /** It was taken hold of, or let go. */
  held(is: boolean): void;
  /** By which world-space matrix what is selected has moved since it was taken hold of. */
  dragged(by: Matrix4): void;
}

export class Grip {
  private readonly controls: TransformControls;
  private readonly pivot = new Object3D();
  private readonly start = new Matrix4();

  constructor(scene: Scene, camera: Camera, canvas: HTMLElement, grips: Grips) {
    this.controls = new TransformControls(camera, canvas);
    this.controls.setSize(0.8);
    this.controls.addEventListener('change', grips.changed);
    this.controls.addEventListener('objectChange', () => grips.dragged(this.by));
    this.controls.addEventListener('dragging-changed', ({ value }) => {
      if (value) this.start.copy(this.pivot.matrixWorld);
      grips.held(value as boolean);
    });
    scene.add(this.pivot, this.controls.getHelper());
  }

  /** The axis that the pointer is over. */
  get axis(): string | null {
    return this.controls.axis;
  }

  get isHeld(): boolean {
    return this.controls.dragging;
  }

  /** Since it was taken hold of. */
  get by(): Matrix4 {
    this.pivot.updateMatrix();
    return this.pivot.matrix.clone().multiply(this.start.clone().invert());
  }

  /** Stands somewhere, upright, or nowhere. */
  put(at: Vector3 | null): void {
    if (!at) {
      this.controls.detach();
      return;
    }
    this.pivot.position.copy(at);
    this.pivot.quaternion.identity();
    this.pivot.scale.set(1, 1, 1);
    this.pivot.updateMatrixWorld(true);
    this.start.copy(this.pivot.matrixWorld);
    this.controls.attach(this.pivot);
  }

  /** What dragging does, and in which steps (0: none): metres, and 15 degrees with any. */
  does(mode: 'translate' | 'rotate' | 'scale', grid: number): void {
    this.controls.setMode(mode);
    this.controls.setTranslationSnap(grid || null);
    this.controls.setRotationSnap(grid ? Math.PI / 12 : null);
    this.controls.setScaleSnap(grid ? 0.1 : null);
  }
}
