// What travels as JSON: the API's own schemas, with lists of a fixed length as such.

import type * as api from './openapi.js';

export type Rgb = [red: number, green: number, blue: number];
export type Point = [x: number, y: number, z: number];

/** A type of which some members are narrower than the description says; what it says has to hold of them still. */
type With<T, Narrower extends Partial<T>> = Omit<T, keyof Narrower> & Narrower;

export type SceneObject = With<api.SceneObject, { bounds: { min: Point; max: Point }; albedo: Rgb }>;
export type LightKind = 'emissive' | 'point' | 'spot' | 'directional' | 'environment';
type Where = { position?: Point | null; direction?: Point | null };
export type Light = With<api.Light, { kind: LightKind; color: Rgb } & Where>;
/** The light of some lights at reference strengths; the map is the sum of weight × layer. */
export type SceneLayer = With<api.SceneLayer, { weight: Rgb; lights: { name: string; reference: Rgb }[] }>;
export type Camera = With<api.Camera, { eye: Point; target: Point; up: Point }>;
export type Scene = With<
  api.Scene,
  { objects: SceneObject[]; lights: Light[]; layers: SceneLayer[]; cameras: Camera[] }
>;
type Pair = [x: number, y: number];
type OnPage = { scale: Pair; offset: Pair };
export type AtlasObject = With<api.AtlasObject, OnPage & { back?: With<api.AtlasPlace, OnPage> | null }>;
export type Atlas = With<api.AtlasDocument, { objects: AtlasObject[] }>;
export type {
  Asset, AssetSummary, Budget, Focus, HistoryEntry, HistoryPage, Job, JobPriority, NewLight, ObjectDetail, Samples,
  SceneEvent, ScenePatch, ScenePlan, SceneSummary, SnapshotEvent, LightError,
} from './openapi.js';

/** What is done to light on its way here; what the service keeps stays as it is. */
export type Filter = 'none' | 'statistical';

/** One edit. */
export type Edit = api.SingleEdit;
/** What every edit request may carry beside its edits. */
export type EditOptions = Omit<api.EditList, 'edits'> & {
  /** `accepted_edits` of the scene that the edits are made for: where it has accepted others since, they are refused (412). */
  ifMatch?: number;
  /** Requests of the same key count once; a new one is made where absent. */
  idempotencyKey?: string;
};

/** How an upload is to be lit: the query of `POST /v1/scenes`. */
export interface Upload {
  name?: string;
  /** Largest distance between neighbouring elements, metres. */
  spacing?: number;
  /** How many elements there are to be, in place of a spacing. */
  elements?: number;
  mode?: 'full' | 'indirect';
  /** Constant radiance from outside. */
  environment?: Rgb;
  /** Asset of a picture of the sky, its turn about +y in degrees, and a factor on its radiance. */
  sky?: string;
  sky_rotation?: number;
  sky_strength?: number;
  /** A plain sky for a scene without any light. */
  default_sky?: boolean;
  /** Angle that the discs of directional lights take up, degrees. */
  sun_angle?: number;
  unit?: 'candela' | 'watt';
  max_albedo?: number;
  layout?: 'vertices' | 'atlas';
  texels_per_metre?: number;
  /** `shared`, `each`, or layers with the names of their lights. */
  layers?: 'shared' | 'each' | Record<string, string[]>;
  bake?: boolean;
  /** What the scene works towards. */
  target?: api.Budget;
  priority?: api.JobPriority;
}

/** Whether a job may still change something. */
export const isOpen = ({ state }: api.Job): boolean => state === 'queued' || state === 'running' || state === 'paused';
