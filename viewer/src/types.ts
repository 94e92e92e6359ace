// What travels as JSON: the parts of the API's description that the page uses.

export type Rgb = [number, number, number];
export type Point = [number, number, number];

export interface SceneObject {
  index: number;
  name: string;
  elements: { first: number; count: number };
  with_back: boolean;
  triangles: number;
  bounds: { min: Point; max: Point };
  albedo: Rgb;
  /** Object space to world space, column-major. */
  transform: number[];
  /** It takes no part in light and has no elements. */
  hidden: boolean;
  /** Index of its node in the uploaded file. */
  node: number | null;
  /** `extras.id` of the node. */
  id: string | null;
}

export interface Light {
  name: string;
  kind: 'emissive' | 'point' | 'spot' | 'directional' | 'environment';
  color: Rgb;
  intensity: number;
  /** The layer that holds its light. */
  layer: string | null;
  object?: string;
  position?: Point;
  direction?: Point;
  /** Of the disc of a directional light, radians. */
  angle?: number;
  /** Of a picture of the sky, degrees. */
  rotation?: number;
}

/** The light of some lights at reference strengths; the map is the sum of weight × layer. */
export interface SceneLayer {
  name: string;
  weight: Rgb;
  lights: { name: string; reference: Rgb }[];
}

export interface Camera {
  index: number;
  name: string;
  eye: Point;
  target: Point;
  up: Point;
  fov_y: number;
}

export interface Scene {
  id: string;
  name: string;
  state: 'preparing' | 'ready' | 'damaged';
  mode: 'full' | 'indirect';
  version: number;
  elements_version: number;
  elements: number;
  estimated_rmse: number | null;
  objects: SceneObject[];
  lights: Light[];
  layers: SceneLayer[];
  cameras: Camera[];
  warnings: string[];
  current_job: string | null;
}

export interface SceneSummary {
  id: string;
  name: string;
  elements: number;
}

export interface Job {
  id: string;
  scene: string;
  kind: 'bake' | 'edit' | 'refine';
  state: 'queued' | 'running' | 'paused' | 'succeeded' | 'failed' | 'canceled';
  cancel_requested: boolean;
  /** The job that does this one's work together with its own. */
  merged_into: string | null;
  progress: {
    fraction: number;
    pass: string | null;
    samples_per_element: number;
    elapsed_ms: number;
    remaining_ms: number | null;
    estimated_rmse: number | null;
    version: number | null;
  };
  error: string | null;
}

/** Whether a job may still change something. */
export const isOpen = (job: Job) => job.state === 'queued' || job.state === 'running' || job.state === 'paused';

/** One edit, as `POST /edits` takes it. */
export type Edit =
  | { op: 'insert'; asset: string; name: string; transform: number[] }
  | { op: 'remove'; objects: string[] }
  | { op: 'move'; object: string; transform: number[] }
  | { op: 'material'; object?: string; material?: string; albedo: Rgb }
  | { op: 'hide' | 'show'; objects: string[] }
  | { op: 'undo' | 'redo' }
  | { op: 'relight'; lights: { light: string; color?: Rgb; intensity?: number }[] }
  | { op: 'insert_light'; name: string; light: object }
  | { op: 'sky'; asset?: string; radiance?: Rgb; rotation?: number; strength?: number }
  | { op: 'remove_light'; light: string }
  | { op: 'move_light'; light: string; position: Point };

/** A camera, as `focus` and `/render` take it. */
export interface View {
  eye: Point;
  target: Point;
  up: Point;
  fov_y: number;
  width: number;
  height: number;
}
