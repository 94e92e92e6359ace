// Made from openapi/openapi.json by generate.mjs: `npm run types`. Not to be edited.

/** An uploaded asset. */
export interface Asset {
  /** Content hash: what `insert` and `sky` name. */
  asset: string;
  /** Triangles in the file; 0 of a picture. */
  triangles: number;
  /** Texels across and down of a picture of the sky, as it is kept; absent of what can be inserted. */
  picture?: number[] | null;
  /** What the file asked for and did not get. */
  warnings: string[];
}

/** One page of assets. */
export interface AssetPage {
  /** Newest first; those from before a restart come behind those after it. */
  items: AssetSummary[];
  /** Asks for the next page; absent on the last. */
  next_cursor?: string | null;
}

/** An asset in a list. */
export interface AssetSummary {
  /** Content hash: what `insert` and `sky` name. */
  asset: string;
  /** Name of its first object; absent of a picture. */
  name?: string | null;
  /** Triangles in the file; 0 of a picture. */
  triangles: number;
  bounds?: Bounds | null;
  /** Texels across and down of a picture of the sky, as it is kept; absent of what can be inserted. */
  picture?: number[] | null;
  /** Bytes of the file. */
  bytes: number;
  /** Bytes that it takes of the service's memory. */
  memory_bytes: number;
  /** Scenes that use it: while there is one, it cannot be deleted. */
  scenes: string[];
}

/** Where the objects of a scene lie in its atlas. */
export interface AtlasDocument {
  /** Version of the light map. */
  version: number;
  /** Texels per metre of surface that were asked for; one per spacing of the elements where the upload did not say. */
  texels_per_metre: number;
  /** The pages. */
  pages: AtlasPage[];
  /** Objects with a surface, in the order of the scene. */
  objects: AtlasObject[];
}

/** Where an object lies. Coordinates on the page are texcoord × scale + offset, from 0 to 1, origin top left. */
export interface AtlasObject {
  /** Its name. */
  object: string;
  /** Index of its page. */
  page: number;
  /** Factor on its coordinates. */
  scale: number[];
  /** What is added. */
  offset: number[];
  /** Whose coordinates they are. */
  texcoord: AtlasTexcoord;
  /** Texels per metre of its surface: fewer than asked for where it would be larger than a page. */
  texels_per_metre: number;
  back?: AtlasPlace | null;
}

/** A page. */
export interface AtlasPage {
  /** Texels across. */
  width: number;
  /** Texels down. */
  height: number;
}

/** A place on a page. */
export interface AtlasPlace {
  /** Index of the page. */
  page: number;
  /** Factor on coordinates. */
  scale: number[];
  /** What is added. */
  offset: number[];
}

/** Whose coordinates an object has. */
export type AtlasTexcoord = "file" | "made";

/** An axis-aligned box in world space, metres. */
export interface Bounds {
  /** Smallest coordinates. */
  min: number[];
  /** Largest coordinates. */
  max: number[];
}

/**
 * When a job stops: the first bound that is reached ends it. With a bound on time or error alone, samples go on
 * until that is reached.
 */
export interface Budget {
  /** Samples per element. */
  samples_per_element?: number | null;
  /** Seconds from when the request was accepted. A job does at least one round, however long that takes. */
  max_seconds?: number | null;
  /** Stated area-weighted RMSE (irradiance / π). */
  target_rmse?: number | null;
}

/** A camera of the file, as `eye`, `target`, `up` and `fov_y` of a focus or a picture. */
export interface Camera {
  /** Its index. */
  index: number;
  /** Its name. */
  name: string;
  /** Where it stands. */
  eye: number[];
  /** A point it looks at, one metre ahead. */
  target: number[];
  /** Upward. */
  up: number[];
  /** Vertical field of view, radians. */
  fov_y: number;
}

/** A camera of the file. */
export type CameraRef = number | string;

/** Shines from afar. */
export interface DirectionalLight {
  kind: "directional";
  /** Where it shines. */
  direction: number[];
  /** Linear RGB factor. */
  color: number[];
  /** Lux on a surface that faces it. */
  intensity: number;
  /** Angle that its disc takes up, radians, at least 0 and below π: the sun's is 0.0093. 0 where absent: hard shadows. */
  angle?: number | null;
}

/** Several edits, applied in order, as a unit or not at all. An empty list lights what canceled jobs left undone. */
export interface EditList {
  /**
   * The edits. Where one carries a `budget`, `focus`, `tiles` or `priority` of its own, the list's counts first, then
   * the first edit's.
   */
  edits: SingleEdit[];
  budget?: Budget | null;
  focus?: Focus | null;
  tiles?: Tiles | null;
  priority?: JobPriority | null;
}

/** One edit with its budget and focus, or several as one job. */
export type EditRequest = EditList | SingleEdit;

/** Neighbouring elements. */
export interface ElementRange {
  /** The first. */
  first: number;
  /** How many. */
  count: number;
}

/** Constant radiance from outside. */
export interface EnvironmentLight {
  kind: "environment";
  /** Linear RGB factor. */
  color: number[];
  /** Radiance. */
  intensity: number;
}

/** How accurate a light map is. */
export interface ErrorReport {
  /** Version of the light map. */
  version: number;
  /** Which light is meant: the scene's mode. */
  part: SamplePart;
  /** Over all surfaces. */
  error: LightError;
  /** Points that resolution was measured at; those inside of solids do not count. */
  points: number;
  /** Object by object, in the order of the scene; hidden ones have no light. */
  objects: ObjectError[];
}

/**
 * What the client looks at: a camera of the file (`camera`), a camera of one's own (`eye`, `target`), or a sphere
 * (`point`, `radius`).
 */
export interface Focus {
  camera?: CameraRef | null;
  /** Where the camera stands. */
  eye?: number[] | null;
  /** What it looks at. */
  target?: number[] | null;
  /** Upward; +y where absent. */
  up?: number[] | null;
  /** Vertical field of view, radians; π/3 where absent. */
  fov_y?: number | null;
  /** Pixels across; with `height` the shape of the picture, 16:9 where absent. */
  width?: number | null;
  /** Pixels down. */
  height?: number | null;
  /** Middle of a sphere. */
  point?: number[] | null;
  /** Radius of the sphere, metres. */
  radius?: number | null;
}

/**
 * Lets lights share a layer of the light map: relighting all of them alike needs no rays, and costs the memory of one
 * layer. A scene has at most 1022 such groups.
 */
export interface GroupLights {
  op: "group_lights";
  /**
   * Name of the layer, and of the group. Absent: the lights belong to no group any more, and stay in the layer that
   * they are in.
   */
  name?: string | null;
  /** Names or nodes of lights. */
  lights: Reference[];
  budget?: Budget | null;
  focus?: Focus | null;
  tiles?: Tiles | null;
  priority?: JobPriority | null;
}

/** `/healthz` and `/readyz`. */
export interface Health {
  /** `ok`. */
  status: string;
}

/**
 * Takes objects out of the light, with the lights on them. They stay in the list and keep their names, places and
 * materials, but have no elements.
 */
export interface Hide {
  op: "hide";
  /** Names, in which `*` matches any part of a name, or nodes. Those that are hidden stay so. */
  objects: Reference[];
  budget?: Budget | null;
  focus?: Focus | null;
  tiles?: Tiles | null;
  priority?: JobPriority | null;
}

/** An accepted edit request. */
export interface HistoryEntry {
  /** Its place among the scene's edit requests, from 1. */
  sequence: number;
  /** As it was sent. */
  request: EditRequest;
  /** The job that lit it, even where it is forgotten by now; none in what an earlier build has kept. */
  job?: string | null;
  /** When it was accepted; none in what an earlier build has kept. */
  accepted_at?: string | null;
  /** It was taken back, and does not count. */
  undone: boolean;
  /** The request that it takes back. */
  undoes?: number | null;
  /** The request that it makes count again. */
  redoes?: number | null;
}

/** One page of a scene's history. */
export interface HistoryPage {
  /** Newest last. */
  items: HistoryEntry[];
  /** The request that `undo` would take back. */
  undo?: number | null;
  /** The request that `redo` would make again. */
  redo?: number | null;
  /** Asks for the next page; absent on the last. */
  next_cursor?: string | null;
}

/** A node of the scene's file, by what the program that wrote it knows it by. */
export interface IdReference {
  /** `extras.id` of the node. */
  id: string;
}

/** Puts an asset into the scene as one object. */
export interface Insert {
  op: "insert";
  /** What `POST /v1/assets` answered. */
  asset: string;
  /** Name of the new object; must be free. */
  name: string;
  /** Asset space to world space, column-major, metres. */
  transform: number[];
  budget?: Budget | null;
  focus?: Focus | null;
  tiles?: Tiles | null;
  priority?: JobPriority | null;
}

/** Adds a light. */
export interface InsertLight {
  op: "insert_light";
  /** Its name; must be free. */
  name: string;
  /** What it is. */
  light: NewLight;
  budget?: Budget | null;
  focus?: Focus | null;
  tiles?: Tiles | null;
  priority?: JobPriority | null;
}

/** The work that brings a light map up to date. */
export interface Job {
  /** Stable id. */
  id: string;
  /** The scene's id. */
  scene: string;
  /** What it lights: the scene's accepted edits up to this one. Of the answer to an edit: the scene's `ETag` from then on. */
  accepted_edits: number;
  /** What it does. */
  kind: JobKind;
  /** Where it stands. */
  state: JobState;
  /** It runs and was asked to stop. */
  cancel_requested: boolean;
  /** It runs and was asked to make room. */
  pause_requested: boolean;
  /** Whose turn comes sooner. */
  priority: JobPriority;
  /**
   * The job that lights this one's edits together with its own. Set while that one runs; this job ends as it does,
   * or waits again where that one is canceled or paused.
   */
  merged_into?: string | null;
  /** How far it is. */
  progress: JobProgress;
  /** When it was accepted. */
  created_at: string;
  /** When it began. */
  started_at?: string | null;
  /** When it ended. */
  finished_at?: string | null;
  /** Why it failed. */
  error?: string | null;
  /** What to know of how it ended: its `target_rmse` counts noise alone, and is met where the error of resolution is larger. */
  warnings: string[];
}

/** What a job does. */
export type JobKind = "bake" | "edit" | "refine";

/** One page of jobs. */
export interface JobPage {
  /** Newest first. */
  items: Job[];
  /** Asks for the next page; absent on the last. */
  next_cursor?: string | null;
}

/** Whose turn comes sooner. Nothing waits for ever: what waits long counts as higher. */
export type JobPriority = "low" | "normal" | "high";

/** How far a job is. */
export interface JobProgress {
  /** Part of the budget that is used, 0 to 1; never falls. */
  fraction: number;
  /** What is being done: `direct`, `object`, `source`, `propagation` or `final_gather`. */
  pass?: string | null;
  /** Samples per element of the rounds that are finished. */
  samples_per_element: number;
  /** Since the job started. */
  elapsed_ms: number;
  /** From here to the end of the budget at the pace so far; absent while nothing is measured. */
  remaining_ms?: number | null;
  /**
   * Stated error of the newest version, of the light that the scene's map holds: area-weighted RMSE (irradiance /
   * π).
   */
  estimated_rmse?: number | null;
  /** Its errors: of chance, and of the distance between elements. */
  light_error: LightError;
  /** Rays traced. */
  rays: number;
  /** Newest version that the job published. */
  version?: number | null;
}

/** Where a job stands. */
export type JobState = "queued" | "running" | "paused" | "succeeded" | "failed" | "canceled";

/** A light. Its strength is `color` × `intensity`, in the unit of its kind. */
export interface Light {
  /** Its name. */
  name: string;
  /** Index of its node in the uploaded file, of an emissive surface that of its object; absent for what was inserted. */
  node?: number | null;
  /** `extras.id` of the node, where the file has one. */
  id?: string | null;
  /** `emissive`, `point`, `spot`, `directional` or `environment`. */
  kind: string;
  /** Linear RGB factor. */
  color: number[];
  /** Radiance (emissive, environment), candela (point, spot), lux (directional), or a factor on a picture of the sky. */
  intensity: number;
  /** The layer of the light map that holds its light; null while the map has no layers, or none of this light yet. */
  layer?: string | null;
  /** The object that emits. */
  object?: string | null;
  /** Where it is. */
  position?: number[] | null;
  /** Where it shines. */
  direction?: number[] | null;
  /** Where the light of a point or spot light ends, metres; absent where it does not. */
  range?: number | null;
  /** Full intensity of a spot light up to this angle from `direction`, radians. */
  inner_cone_angle?: number | null;
  /** No light of a spot light beyond this angle from `direction`, radians. */
  outer_cone_angle?: number | null;
  /** Angle that the disc of a directional light takes up, radians. */
  angle?: number | null;
  /** By how much a picture of the sky is turned about +y, degrees; absent without a picture. */
  rotation?: number | null;
}

/**
 * Errors of light as it is kept, before its noise is averaged away: irradiance / π, mean over RGB, of the light that the
 * map holds. The error of a value that is read between elements is about the root of the sum of both squares.
 */
export interface LightError {
  /** Of chance: it falls with samples. Null where nothing is known, as of an estimate or of light that is not up to date. */
  noise?: number | null;
  /**
   * Of the distance between elements: it falls with their spacing, and no number of samples makes it smaller. Null
   * where the noise is not known, where too few points were measured, or where it is too small to be told from noise.
   */
  resolution?: number | null;
}

/** Gives an object a new place. */
export interface Move {
  op: "move";
  /** Its name or node. */
  object: Reference;
  /** Object space to world space, column-major, metres; replaces the present one. */
  transform: number[];
  /**
   * It is being dragged: its light ends with its first round where the next step of the same drag waits by then. Later
   * steps start from the light before the drag.
   */
  drag?: boolean;
  budget?: Budget | null;
  focus?: Focus | null;
  tiles?: Tiles | null;
  priority?: JobPriority | null;
}

/** Moves a point or spot light, turns a spot or directional light. */
export interface MoveLight {
  op: "move_light";
  /** Its name or node. */
  light: Reference;
  /** New place. */
  position?: number[] | null;
  /** New direction in which it shines. */
  direction?: number[] | null;
  /**
   * It is being dragged: a quick estimate is published at once, and the exact update follows unless the next step of
   * the same drag waits by then. No later light starts from an estimate. The light gets a layer of its own.
   */
  drag?: boolean;
  budget?: Budget | null;
  focus?: Focus | null;
  tiles?: Tiles | null;
  priority?: JobPriority | null;
}

/** A light to add. */
export type NewLight = PointLight | SpotLight | DirectionalLight | EnvironmentLight;

/** A node of the scene's file. */
export interface NodeReference {
  /** Index in the file's list of nodes. */
  node: number;
}

/** An object with its materials, and its light as a whole. */
export interface ObjectDetail {
  /** Version of the light map. */
  version: number;
  /** Version at which elements, objects or lights last changed. */
  elements_version: number;
  /** As the scene lists it. */
  object: SceneObject;
  /** Its mesh as the file has it. */
  mesh: ObjectMesh;
  /** Its materials, in the order of its file. */
  materials: ObjectMaterial[];
  /** Area of its elements, m². */
  area: number;
  /** Mean of the light map over that area, in the scene's mode; none where it has no elements. */
  light?: number[] | null;
}

/** How accurate the light of an object is. */
export interface ObjectError {
  /** Its name. */
  object: string;
  /** Over its surface. */
  error: LightError;
  /** Points on it. */
  points: number;
}

/** A material of an object. */
export interface ObjectMaterial {
  /** Its name in the file; empty where it has none. */
  name: string;
  /** Mean diffuse albedo, linear RGB, as the file or the last repaint has it. */
  albedo: number[];
  /** Radiance that it emits now, linear RGB. */
  emission: number[];
  /** Mean share of light that does not go through it. */
  opacity: number;
  /** Its back is a surface like its front. */
  double_sided: boolean;
}

/** A mesh as the file has it, before subdivision. */
export interface ObjectMesh {
  /** Its vertices. */
  vertices: number;
  /** Its triangles. */
  triangles: number;
  /** Some of it has normals of its own. */
  has_normals: boolean;
  /** Sets of texture coordinates that are known: those that pictures of its materials read. */
  texture_coordinates: number;
}

/** One page of objects. */
export interface ObjectPage {
  /** In the order of `index`. */
  items: SceneObject[];
  /** Version of the light map. */
  version: number;
  /**
   * Version at which elements, objects or lights last changed. Pages of different ones, or of different numbers of
   * accepted edits, do not belong together.
   */
  elements_version: number;
  /** Edits of the scene that were accepted: all of them are in the list. */
  accepted_edits: number;
  /** Asks for the next page; absent on the last. */
  next_cursor?: string | null;
}

/** What becomes of textures and vertex colours where a material is painted. */
export type PaintedTexture = "replace" | "multiply";

/** Shines in all directions. */
export interface PointLight {
  kind: "point";
  /** Where it is. */
  position: number[];
  /** Linear RGB factor. */
  color: number[];
  /** Candela. */
  intensity: number;
  /** Its light ends here, metres. */
  range?: number | null;
}

/** A grid of probes: `index` = *i* + *nx* (*j* + *ny* *k*), its point is `origin` + `spacing` × (*i*, *j*, *k*). */
export interface ProbeGrid {
  /** The first point, world space, metres. */
  origin: number[];
  /** Metres between neighbours. */
  spacing: number;
  /** Points along x, y and z. */
  counts: number[];
}

/** The light around a point. */
export interface ProbeLight {
  /** Its place in the grid, or in the request. */
  index: number;
  /** World space, metres. */
  position: number[];
  /**
   * Nine coefficients, linear RGB, of the incoming radiance over all directions (not convolved with a cosine) in
   * real orthonormal spherical harmonics without the Condon-Shortley phase, world axes: 1, y, z, x, xy, yz, 3z²−1,
   * xz, x²−y². What `SphericalHarmonics3` of three.js takes, in its order and signs. Times 1, 2/3 and 1/4 by band
   * they are those of irradiance / π.
   */
  coefficients: number[][];
  /**
   * Standard error of each coefficient, mean over RGB, from the scatter of its samples; null where the light map
   * states none, or is not up to date with the objects.
   */
  error?: number[] | null;
  /**
   * Share of the directions in which no back of a single-sided surface or of a solid is seen: 1 in the open, 0
   * inside of solids.
   */
  validity: number;
  /** Version of the light map that it was computed from. */
  version: number;
}

/** Probes of a scene. */
export interface Probes {
  /** Version of the light map. */
  version: number;
  /**
   * All probes of the request are here. Where not, those that are not here have the light that they had at version
   * `since`, up to their error.
   */
  complete: boolean;
  /** Samples per probe. */
  samples: number;
  grid?: ProbeGrid | null;
  /** By index. */
  probes: ProbeLight[];
}

/** Probes at points of their own. */
export interface ProbesRequest {
  /** Position x y z of each, world space, metres. */
  points: number[][];
  /** Samples per probe; 256 where absent. */
  samples?: number | null;
  /**
   * A version that this same request was answered with `since`: only probes whose light has changed since then by
   * more than its error come. 0 begins.
   */
  since?: number | null;
}

/** A problem document. */
export interface ProblemDocument {
  /** Stable URI of the kind of problem; `GET` it for a description. */
  type: string;
  /** The kind of problem in words. */
  title: string;
  /** HTTP status. */
  status: number;
  /** What was wrong. */
  detail: string;
  /** The field at fault, where there is one. */
  field?: string | null;
}

/** Makes the last request again that was taken back. Any other edit ends what can be made again. */
export interface Redo {
  op: "redo";
  /** Of a drag all steps at once. */
  drag?: boolean;
  budget?: Budget | null;
  focus?: Focus | null;
  tiles?: Tiles | null;
  priority?: JobPriority | null;
}

/** An object or a light of a scene. */
export type Reference = string | NodeReference | IdReference;

/** Changes colour or intensity of lights. */
export interface Relight {
  op: "relight";
  /** Light by light. */
  lights: RelightOne[];
  budget?: Budget | null;
  focus?: Focus | null;
  tiles?: Tiles | null;
  priority?: JobPriority | null;
}

/** New colour or intensity of one light; what is absent stays. */
export interface RelightOne {
  /** Its name or node. */
  light: Reference;
  /** Linear RGB factor. */
  color?: number[] | null;
  /** Scalar factor. */
  intensity?: number | null;
}

/** Takes objects out, with the lights on them. */
export interface Remove {
  op: "remove";
  /** Names, in which `*` matches any part of a name, or nodes. A request may hold 4096 of them, 64 with a `*`. */
  objects: Reference[];
  budget?: Budget | null;
  focus?: Focus | null;
  tiles?: Tiles | null;
  priority?: JobPriority | null;
}

/** Takes a light away. An emissive surface stays as an object that emits nothing. */
export interface RemoveLight {
  op: "remove_light";
  /** Its name or node. */
  light: Reference;
  budget?: Budget | null;
  focus?: Focus | null;
  tiles?: Tiles | null;
  priority?: JobPriority | null;
}

/** Repaints an object, a material wherever it is, or the parts of one object that have it. */
export interface Repaint {
  op: "material";
  object?: Reference | null;
  /** Name of the material in the file; without it all materials of the object. */
  material?: string | null;
  /** Diffuse albedo, linear RGB, each 0 to 1. */
  albedo: number[];
  texture?: PaintedTexture | null;
  budget?: Budget | null;
  focus?: Focus | null;
  tiles?: Tiles | null;
  priority?: JobPriority | null;
}

/** Light at one point. */
export interface Sample {
  /** irradiance / π on the side of the normal, linear RGB. */
  light: number[];
  /**
   * Its standard error, mean over RGB, from the scatter of its samples; null where the light map that was gathered
   * from states none, or is not up to date with the objects.
   */
  error?: number | null;
}

/** Which light is sampled. */
export type SamplePart = "full" | "direct" | "indirect";

/** Points to sample. */
export interface SampleRequest {
  /**
   * Position x y z (world space, metres) and normal x y z (of any length but zero) of each. Points × samples are at
   * most 8,388,608.
   */
  points: number[][];
  /** Samples per point; 256 where absent. */
  samples?: number | null;
  part?: SamplePart | null;
}

/** Light at points. */
export interface Samples {
  /** Version of the light map that indirect light was gathered from. */
  version: number;
  /** Which light it is. */
  part: SamplePart;
  /** In the order of the request. */
  points: Sample[];
}

/** A scene with all that is in it. */
export interface Scene {
  /** Stable id. */
  id: string;
  /** Name for people. */
  name: string;
  /** Whether it can be worked with. */
  state: SceneState;
  /** What the light map holds. */
  mode: SceneMode;
  /** Largest distance between neighbouring elements, metres. */
  spacing: number;
  sizing?: Sizing | null;
  /** Texels per metre of its atlas; absent where it was uploaded without one. */
  texels_per_metre?: number | null;
  /** Version of the light map; 0 before anything was published. */
  version: number;
  /** Version at which elements, objects or lights last changed: fetch `/elements` again where it did. */
  elements_version: number;
  /** Length of the light map. Elements of removed objects leave holes of zeros; the length never falls. */
  elements: number;
  /** Elements in use. */
  live_elements: number;
  /** Triangles after subdivision. */
  triangles: number;
  /** Memory that the scene holds. */
  memory_bytes: number;
  /**
   * Stated error of the light that the map holds (`mode`): area-weighted RMSE (irradiance / π). Null where nothing is
   * known of it, as of an estimate, or of light from before an edit.
   */
  estimated_rmse?: number | null;
  /**
   * Its errors: of chance, and of the distance between elements, which is measured while light is computed. Null after an
   * edit until there is light for it.
   */
  light_error: LightError;
  target?: Budget | null;
  /** Edit requests that were accepted so far and changed something. The scene's `ETag`, which `If-Match` compares with. */
  accepted_edits: number;
  /**
   * How many of those `version` shows with their geometry. While it is below `accepted_edits`, objects and lights are
   * told as all accepted edits leave them, and objects have the elements that they have in `version`.
   */
  published_edits: number;
  /** Accepted edits whose light is not in the map yet: those of jobs that wait, run or were canceled. */
  unlit_edits: number;
  /**
   * The objects, in order, after all accepted edits. Their `albedo` is the mean of the file or of the last repaint; light meets at most
   * `max_albedo`.
   */
  objects: SceneObject[];
  /** The lights, in order, after all accepted edits. */
  lights: Light[];
  /**
   * The layers of the light map: it is the sum of weight × layer. None before a light is relit or lights are
   * grouped.
   */
  layers: SceneLayer[];
  /** The file's cameras, in order. */
  cameras: Camera[];
  /** What the file asked for and did not get. */
  warnings: string[];
  /** Triangles without an area, dropped at upload. */
  degenerate_triangles: number;
  /** The job that runs on the scene, else the next one. */
  current_job?: string | null;
  /** What is wrong with it: it is damaged, or its light could not be saved. */
  error?: string | null;
  /** When it was uploaded. */
  created_at: string;
}

/** What happened to a scene. */
export type SceneChange = "edited" | "damaged" | "deleted";

/** Data of a `scene` event. */
export interface SceneEvent {
  /** The scene's id. */
  scene: string;
  /** What happened. */
  what: SceneChange;
  /** The scene's version. */
  version: number;
  /** Version at which elements, objects or lights last changed. */
  elements_version: number;
}

/** A layer: the light of some lights at reference strengths. */
export interface SceneLayer {
  /** Its name: that of its group or its light, or `shared`. */
  name: string;
  /**
   * What it counts in the light map at this version, per channel. A client that relights by itself takes the new
   * strength over the reference instead.
   */
  weight: number[];
  /** Its lights. */
  lights: SceneLayerLight[];
  /** Memory that it takes: 36 bytes per element. */
  memory_bytes: number;
}

/** A light of a layer. */
export interface SceneLayerLight {
  /** Name of the light. */
  name: string;
  /** Strength (`color` × `intensity`) at which the layer holds its light. */
  reference: number[];
}

/** What a light map holds, and what its error is stated of. */
export type SceneMode = "full" | "indirect";

/** An object: a glTF node with a mesh, the unit of an edit. */
export interface SceneObject {
  /** Its index in `/elements`; beyond those where it is not published yet. */
  index: number;
  /** Its name. */
  name: string;
  /** Its elements; none before it is published. */
  elements: ElementRange;
  /** Errors of its light. */
  light_error: LightError;
  /** The second half of its elements belongs to the back of its surface. */
  with_back: boolean;
  /** Triangles after subdivision. */
  triangles: number;
  /** Where it is. */
  bounds: Bounds;
  /**
   * Mean diffuse albedo, linear RGB, as the file or the last repaint has it. Light meets at most the scene's
   * `max_albedo`.
   */
  albedo: number[];
  /** Object space to world space, column-major, metres: what `move` replaces. */
  transform: number[];
  /** Hidden by an edit: it takes no part in light and has no elements until it is shown. */
  hidden: boolean;
  /** Index of its node in the uploaded file; none for what was inserted. */
  node?: number | null;
  /** `extras.id` of the node, where the file has one. */
  id?: string | null;
}

/** One page of scenes. */
export interface ScenePage {
  /** Newest first. */
  items: SceneSummary[];
  /** Asks for the next page; absent on the last. */
  next_cursor?: string | null;
}

/** What of a scene is to change; what is absent stays. */
export interface ScenePatch {
  /** Name for people. */
  name?: string | null;
  target?: Budget | null;
}

/** What a scene would take: the answer to an upload with `dry_run=true`. */
export interface ScenePlan {
  /** Largest distance between neighbouring elements, metres: as asked for, else as it would be chosen. */
  spacing: number;
  /** Elements of the light map. */
  elements: number;
  /** Triangles after subdivision. */
  triangles: number;
  /** Number of objects. */
  objects: number;
  /** Number of lights. */
  lights: number;
  /** Memory that the scene would hold before its first edit, with its layers. */
  memory_bytes: number;
  /** What the file asks for and would not get. */
  warnings: string[];
  /** Triangles without an area, which would be dropped. */
  degenerate_triangles: number;
}

/** Whether a scene can be worked with. */
export type SceneState = "preparing" | "ready" | "damaged";

/** A scene in a list. */
export interface SceneSummary {
  /** Stable id. */
  id: string;
  /** Name for people. */
  name: string;
  /** Whether it can be worked with. */
  state: SceneState;
  /** What the light map holds. */
  mode: SceneMode;
  /** Largest distance between neighbouring elements, metres. */
  spacing: number;
  /** Version of the light map. */
  version: number;
  /** Length of the light map. */
  elements: number;
  /** Number of objects. */
  object_count: number;
  /** The job that runs on the scene, else the next one. */
  current_job?: string | null;
  /** What is wrong with it: it is damaged, or its light could not be saved. */
  error?: string | null;
  /** When it was uploaded. */
  created_at: string;
}

/** Brings hidden objects back, with the lights on them. */
export interface Show {
  op: "show";
  /** Names, in which `*` matches any part of a name, or nodes. Those that are not hidden stay so. */
  objects: Reference[];
  budget?: Budget | null;
  focus?: Focus | null;
  tiles?: Tiles | null;
  priority?: JobPriority | null;
}

/** One edit. */
export type SingleEdit = Insert | Remove | Move | Repaint | Hide | Show | Undo | Redo | Relight | InsertLight | Sky | RemoveLight | MoveLight | GroupLights;

/** How the elements of a scene are spread over what they lie on. */
export type Sizing = "uniform" | "light";

/**
 * Gives the scene its light from outside, instead of what it has of it: a picture or the same from everywhere. The light
 * is named `environment`, and is relit, grouped and removed as others are.
 */
export interface Sky {
  op: "sky";
  /** An equirectangular picture: what `POST /v1/assets` answered. Either it or `radiance`. */
  asset?: string | null;
  /** Linear RGB radiance from everywhere. Either it or `asset`. */
  radiance?: number[] | null;
  /** By how much the picture is turned about +y, counter-clockwise seen from above, degrees; 0 where absent. */
  rotation?: number | null;
  /** Factor on the radiance; 1 where absent. */
  strength?: number | null;
  budget?: Budget | null;
  focus?: Focus | null;
  tiles?: Tiles | null;
  priority?: JobPriority | null;
}

/** Data of a `snapshot` event: a new version is there. */
export interface SnapshotEvent {
  /** The scene's id. */
  scene: string;
  /** The job that published it; none where no job waited and the map was refined in idle time. */
  job?: string | null;
  /** The new version. */
  version: number;
  /** Version at which elements, objects or lights last changed. */
  elements_version: number;
  /**
   * Of the rounds so far, of the job or of this spell of idle time; absent where old light was carried over to new
   * geometry.
   */
  samples_per_element?: number | null;
  /** Stated error of this version; null where old light was carried over to another scene, or an estimate is shown. */
  estimated_rmse?: number | null;
  /** Its errors: of chance, and of the distance between elements. */
  light_error: LightError;
}

/** Shines in a cone. */
export interface SpotLight {
  kind: "spot";
  /** Where it is. */
  position: number[];
  /** Where it shines. */
  direction: number[];
  /** Linear RGB factor. */
  color: number[];
  /** Candela. */
  intensity: number;
  /** Full intensity up to this angle from `direction`, radians; 0 where absent. */
  inner_cone_angle?: number | null;
  /** No light beyond this angle, radians; π/4 where absent. */
  outer_cone_angle?: number | null;
  /** Its light ends here, metres. */
  range?: number | null;
}

/** How tiles are gone through. */
export type TileMode = "global" | "incremental" | "continuous";

/**
 * How what is lit first is cut up: tile after tile, each published as soon as it has its samples, in the order of
 * importance. With a `focus` that gives a camera the order is by Chebyshev distance on screen from what is edited, of
 * what the camera sees; in a sphere by distance from its middle. Without `focus` it is by a bound on the change, and
 * elements whose bound is below a hundredth of the largest come with the rest. The rest of the map follows.
 * Lights that move are baked anew: their light is shown everywhere at once, roughly, and what is in focus gets its
 * samples together.
 *
 * A newer edit of the scene ends the order: tiles that are not done are left, the map is completed, the job has
 * succeeded, and the newer edit begins at its own place.
 */
export interface Tiles {
  /** Elements per tile, about; 256 where absent. Tiles are larger where there would be more than 256 of them. */
  size?: number | null;
  /** Samples per element of each tile; 64 where absent. Never more than the budget has. */
  samples?: number | null;
  mode?: TileMode | null;
}

/**
 * Takes the last edit request back that counts. What it changed is as before it; the light too, bit for bit where it is
 * still kept.
 */
export interface Undo {
  op: "undo";
  /** Of a drag all steps at once. */
  drag?: boolean;
  budget?: Budget | null;
  focus?: Focus | null;
  tiles?: Tiles | null;
  priority?: JobPriority | null;
}
