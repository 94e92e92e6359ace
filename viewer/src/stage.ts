// The scene in 3D: meshes that show the light map, markers for lights, camera, picking, gizmo.

import {
  AgXToneMapping, Box3, BufferGeometry, Color, Group, Matrix4, Mesh, MeshStandardMaterial, PerspectiveCamera,
  Raycaster, Scene as ThreeScene, ShaderMaterial, Vector2, Vector3, WebGLRenderer, type Object3D,
} from 'three';
import { readsOf, type Camera, type Point, type Scene } from 'rebake';
import { OrbitControls } from 'three/examples/jsm/controls/OrbitControls.js';
import { GLTFLoader } from 'three/examples/jsm/loaders/GLTFLoader.js';
import type { LightMap } from './lightmap';
import { Grip } from './grip';
import { Markers } from './markers';
import { shared, surface } from './material';
import { asItWas } from './past';
import type { Picked } from './selection';
import { drops, spotAt, type Spot } from './surfaces';
import type { View } from './api';

export class Stage {
  /** Something was clicked, or nothing; with `isMore` beside what is selected. */
  onPick: (picked: Picked | null, isMore: boolean) => void = () => {};
  /** What is selected was taken hold of, is dragged, was let go: by which world-space matrix it has moved since. */
  onGrab: () => void = () => {};
  onDrag: (by: Matrix4) => void = () => {};
  onDrop: (by: Matrix4) => void = () => {};
  /** The camera came to rest. */
  onCamera: () => void = () => {};
  /** Milliseconds from frame to frame, when something moved last. */
  frameMs = 0;
  split = false;

  private readonly renderer: WebGLRenderer;
  private readonly scene = new ThreeScene();
  private readonly camera = new PerspectiveCamera(60, 1, 0.01, 1000);
  private readonly orbit: OrbitControls;
  private readonly gizmo: Grip;
  private readonly objects = new Map<string, Group>();
  /** What stood where before the last edit, with its light of then; null where that is what stands there now. */
  private past: Group[] | null = null;
  private readonly markers = new Markers(this.scene);
  private selected: readonly Picked[] = [];
  /** Where the meshes have the objects, and what is in the hand was taken hold of: by name, with its kind. */
  private readonly stood = new Map<string, Matrix4>();
  private grabbed = new Map<string, Matrix4>();
  private dirty = true;

  constructor(private readonly canvas: HTMLCanvasElement) {
    this.renderer = new WebGLRenderer({ canvas, antialias: true });
    this.renderer.toneMapping = AgXToneMapping;
    this.renderer.autoClear = false;
    this.scene.background = new Color(0x08090b);
    this.orbit = new OrbitControls(this.camera, canvas);
    this.orbit.addEventListener('change', () => this.invalidate());
    this.orbit.addEventListener('end', () => this.onCamera());
    this.gizmo = new Grip(this.scene, this.camera, canvas, {
      changed: () => this.invalidate(),
      held: (is) => this.held(is),
      dragged: (by) => {
        this.shift(by);
        this.onDrag(by);
      },
    });
    this.watchClicks();
    new ResizeObserver(() => this.resize()).observe(canvas.parentElement!);
    this.resize();
    let last = 0;
    const frame = (now: number) => {
      requestAnimationFrame(frame);
      if (!this.dirty) {
        last = 0;
        return;
      }
      // From frame to frame while something moves: what the graphics card takes is in it.
      if (last) this.frameMs = now - last;
      last = now;
      this.draw();
    };
    requestAnimationFrame(frame);
  }

  /** Something is in the hand. */
  get isHeld(): boolean {
    return this.gizmo.isHeld;
  }

  invalidate(): void {
    this.dirty = true;
  }

  set exposure(stops: number) {
    this.renderer.toneMappingExposure = 2 ** stops;
    this.invalidate();
  }

  /** An edit is about to change the scene: what is there now is what the split view shows on its left. */
  remember(): void {
    this.dispose(this.past ?? []);
    this.past = null;
  }

  /** Shows nothing. */
  clear(): void {
    this.select([]);
    this.remember();
    this.dispose(this.objects.values());
    this.objects.clear();
    this.markers.show([], 1);
    this.invalidate();
  }

  /** Shows the meshes of a light map file. Nodes carry the objects' names, vertices are elements in order. */
  async show(file: ArrayBuffer, scene: Scene, map: LightMap): Promise<void> {
    const gltf = await new GLTFLoader().parseAsync(file, '');
    map.grow(scene.elements);
    map.release();
    if (this.past || this.objects.size === 0) this.dispose(this.objects.values());
    else this.past = [...this.objects.values()].map(asItWas);
    this.objects.clear();
    for (const node of [...gltf.scene.children]) {
      // The loader changes names that its animations could not address.
      const name: string = node.userData['name'] ?? node.name;
      const object = scene.objects.find((o) => o.name === name);
      if (!object) continue;
      const group = new Group();
      const { light, base } = map.attributes(object, readsOf(node));
      node.updateMatrixWorld(true);
      node.traverse((child) => {
        if (!(child instanceof Mesh)) return;
        const geometry: BufferGeometry = child.geometry;
        for (const unused of ['color', '_elements', '_weights']) geometry.deleteAttribute(unused);
        geometry.setAttribute('light', light);
        geometry.setAttribute('base', base);
        const from = child.material as MeshStandardMaterial;
        const emission = from.emissive.clone().multiplyScalar(from.emissiveIntensity);
        const doubleSided = from.side === 2 && !object.with_back;
        const mesh = new Mesh(geometry, surface(from.color, emission, doubleSided, from.opacity));
        mesh.matrixAutoUpdate = false;
        mesh.matrix.copy(child.matrixWorld);
        group.add(mesh);
      });
      group.matrixAutoUpdate = false;
      this.stood.set(name, new Matrix4().fromArray(object.transform));
      group.userData['picked'] = { kind: 'object', name } satisfies Picked;
      this.objects.set(name, group);
      this.scene.add(group);
    }
    this.look(scene);
    this.select(this.selected);
  }

  /** Albedo, emission and lights as the scene has them. */
  look(scene: Scene): void {
    for (const object of scene.objects) {
      const lights = scene.lights.filter((light) => light.object === object.name);
      this.materials(object.name).forEach(({ uniforms }, _, all) => {
        if (all.length === 1) uniforms['albedo']!.value.fromArray(object.albedo);
        if (all.length === 1 && lights.length < 2) {
          const strength = lights[0] ? lights[0].color.map((c) => c * lights[0]!.intensity) : [0, 0, 0];
          uniforms['emission']!.value.fromArray(strength);
        }
      });
    }
    const size = scene.objects.length ? this.bounds().getSize(new Vector3()).length() : 1;
    this.markers.show(scene.lights, size / 120);
    if (this.gizmo.isHeld) this.shift(this.gizmo.by);
    this.invalidate();
  }

  /** An albedo in advance of the service's answer. */
  paint(name: string, albedo: Point): void {
    for (const { uniforms } of this.materials(name)) uniforms['albedo']!.value.fromArray(albedo);
    this.invalidate();
  }

  select(selected: readonly Picked[]): void {
    this.selected = selected;
    const names = new Set(selected.filter(({ kind }) => kind === 'object').map(({ name }) => name));
    for (const [name, group] of this.objects) {
      for (const child of group.children) ((child as Mesh).material as ShaderMaterial).uniforms['selected']!.value = names.has(name) ? 1 : 0;
    }
    // What is in the hand stays there.
    if (!this.gizmo.isHeld) this.gizmo.put(this.selectedBox()?.getCenter(new Vector3()) ?? null);
    this.invalidate();
  }

  /** What dragging the gizmo does, and in which steps (0: none): metres, and 15 degrees with any. */
  gizmoDoes(mode: 'translate' | 'rotate' | 'scale', grid: number): void {
    this.gizmo.does(mode, grid);
    this.invalidate();
  }

  /** By how much each of these objects has to rise to stand on what is below it, the others where they come to stand. */
  dropsOf(names: string[]): Map<string, number> {
    const found = drops(names, this.objects, place);
    this.invalidate();
    return found;
  }

  /** Everything stands where the scene has it: what was moved here was not moved there. */
  settleBack(): void {
    for (const group of this.objects.values()) place(group, new Matrix4());
    for (const { name } of this.selected) this.markers.settleBack(name);
    this.select(this.selected);
  }

  /** What is seen under a pointer; null where nothing is. */
  spotUnder(event: MouseEvent): Spot | null {
    return spotAt(this.within(event), this.camera, [...this.objects.values()]);
  }

  /** What is seen in the middle of the view; where nothing is, level ground at what the camera turns about. */
  ahead(): Spot {
    const found = spotAt(new Vector2(0, 0), this.camera, [...this.objects.values()]);
    return found ?? { point: this.orbit.target.clone(), normal: new Vector3(0, 1, 0) };
  }

  /** Stands where a camera of the file stands, with the horizon level. */
  use(camera: Camera): void {
    this.camera.fov = (camera.fov_y * 180) / Math.PI;
    this.camera.position.fromArray(camera.eye);
    const center = this.bounds().getCenter(new Vector3());
    const ahead = new Vector3().fromArray(camera.target).sub(this.camera.position).normalize();
    // Orbits around what it looks at, about the middle of the scene.
    const distance = Math.max(center.sub(this.camera.position).dot(ahead), 0.5);
    this.orbit.target.copy(this.camera.position).addScaledVector(ahead, distance);
    this.settle();
  }

  /** The whole scene from above one corner; walls are seen through from behind. */
  overview(): void {
    const bounds = this.bounds();
    const radius = bounds.getSize(new Vector3()).length() / 2 || 1;
    this.camera.fov = 45;
    bounds.getCenter(this.orbit.target);
    this.camera.position.copy(this.orbit.target).addScaledVector(new Vector3(0.5, 0.55, 0.75), radius * 2.2);
    this.settle();
  }

  /** Turns to the selected, from where it fills most of the view. */
  frameSelected(): void {
    const box = this.selectedBox();
    if (!box) return;
    const [middle, size] = [box.getCenter(new Vector3()), box.getSize(new Vector3()).length() / 2];
    const least = this.bounds().getSize(new Vector3()).length() / 12;
    const half = (Math.min(this.camera.fov, this.camera.fov * this.camera.aspect) * Math.PI) / 360;
    const back = this.camera.position.clone().sub(this.orbit.target).normalize();
    this.orbit.target.copy(middle);
    this.camera.position.copy(middle).addScaledVector(back, (1.25 * Math.max(size, least)) / Math.sin(half));
    this.settle();
  }

  /** The camera as the service takes it. */
  view(): View {
    const size = this.renderer.getSize(new Vector2());
    return {
      eye: this.camera.position.toArray() as Point,
      target: this.orbit.target.toArray() as Point,
      up: this.camera.up.toArray() as Point,
      fov_y: (this.camera.fov * Math.PI) / 180,
      width: Math.max(1, Math.round(size.x)),
      height: Math.max(1, Math.round(size.y)),
    };
  }

  /** Where a world-space point is on the screen, in parts of the picture from its top left. */
  project(point: Point): [number, number] {
    const p = new Vector3().fromArray(point).project(this.camera);
    return [(p.x + 1) / 2, (1 - p.y) / 2];
  }

  private materials(name: string): ShaderMaterial[] {
    return (this.objects.get(name)?.children ?? []).map((child) => (child as Mesh).material as ShaderMaterial);
  }

  private bounds(): Box3 {
    const box = new Box3();
    for (const group of this.objects.values()) box.expandByObject(group);
    return box;
  }

  private settle(): void {
    const radius = this.bounds().getSize(new Vector3()).length() || 1;
    this.camera.near = radius / 2000;
    this.camera.far = radius * 20;
    this.camera.updateProjectionMatrix();
    this.orbit.update();
    this.invalidate();
    this.onCamera();
  }

  private dispose(groups: Iterable<Group>): void {
    for (const group of groups) {
      this.scene.remove(group);
      for (const child of group.children) {
        (child as Mesh).geometry.dispose();
        ((child as Mesh).material as ShaderMaterial).dispose();
      }
    }
  }

  /** What of the scene is selected and shown, as a box. */
  private selectedBox(): Box3 | null {
    const shown = this.selected.flatMap(({ kind, name }): Object3D[] => {
      const found = kind === 'object' ? this.objects.get(name) : this.markers.get(name);
      return found ? [found] : [];
    });
    const box = new Box3();
    for (const one of shown) box.expandByObject(one);
    return box.isEmpty() ? null : box;
  }

  /** Shows what is selected by so much beside where it was taken hold of, wherever the scene has it by now. */
  private shift(by: Matrix4): void {
    for (const { kind, name } of this.selected) {
      const [group, stood, from] = [kind === 'object' ? this.objects.get(name) : undefined, this.stood.get(name), this.grabbed.get(name)];
      if (group) place(group, stood && from ? by.clone().multiply(from).multiply(stood.clone().invert()) : by);
      else this.markers.move(name, by);
    }
    this.invalidate();
  }

  private held(is: boolean): void {
    this.orbit.enabled = !is;
    if (is) {
      this.grabbed = new Map([...this.objects].map(([name, group]) => [name, group.matrix.clone().multiply(this.stood.get(name)!)]));
      this.markers.grab();
      return this.onGrab();
    }
    const { by } = this.gizmo;
    this.onDrop(by);
    this.select(this.selected);
  }

  private watchClicks(): void {
    let down: Vector2 | null = null;
    this.canvas.addEventListener('pointerdown', (e) => (down = e.button === 0 ? new Vector2(e.clientX, e.clientY) : null));
    this.canvas.addEventListener('pointerup', (e) => {
      // A click, not the end of an orbit or of a drag at the gizmo.
      if (!down || down.distanceTo(new Vector2(e.clientX, e.clientY)) > 4 || this.gizmo.axis) return;
      this.onPick(this.at(e), e.shiftKey || e.ctrlKey || e.metaKey);
    });
  }

  /** Where in the view a pointer is, from −1 to 1. */
  private within(event: MouseEvent): Vector2 {
    const box = this.canvas.getBoundingClientRect();
    return new Vector2(((event.clientX - box.left) / box.width) * 2 - 1, 1 - ((event.clientY - box.top) / box.height) * 2);
  }

  private at(event: MouseEvent): Picked | null {
    const ray = new Raycaster();
    ray.setFromCamera(this.within(event), this.camera);
    const [hit] = ray.intersectObjects([...this.markers.meshes, ...this.objects.values()], true);
    return hit?.object.userData['picked'] ?? hit?.object.parent?.userData['picked'] ?? null;
  }

  private resize(): void {
    const { clientWidth, clientHeight } = this.canvas.parentElement!;
    const [width, height] = [Math.max(1, clientWidth), Math.max(1, clientHeight)];
    this.renderer.setPixelRatio(Math.min(devicePixelRatio, 2));
    this.renderer.setSize(width, height, false);
    this.camera.aspect = width / height;
    this.camera.updateProjectionMatrix();
    this.invalidate();
  }

  /** Has what stood there before the edit in the picture, or what stands there now. */
  private showPast(is: boolean): void {
    if (!this.past) return;
    for (const group of this.past) group.visible = is;
    for (const group of this.objects.values()) group.visible = !is;
  }

  private draw(): void {
    this.dirty = false;
    const { x: width, y: height } = this.renderer.getSize(new Vector2());
    this.renderer.setScissorTest(false);
    this.renderer.clear();
    if (this.split) {
      this.renderer.setScissorTest(true);
      for (const [before, left] of [[1, 0], [0, width / 2]] as const) {
        shared.before.value = before;
        this.showPast(before === 1);
        this.renderer.setScissor(left, 0, width / 2, height);
        this.renderer.render(this.scene, this.camera);
      }
      this.renderer.setScissorTest(false);
    } else {
      shared.before.value = 0;
      this.renderer.render(this.scene, this.camera);
    }
  }
}

/** Its meshes carry their place themselves: the group's matrix is what was moved since. */
function place(group: Group, by: Matrix4): void {
  group.matrix.copy(by);
  group.updateMatrixWorld(true);
}
