// The HTTP API, call by call. Every refusal is a [Refused] whose message a person can act on.

import { follow, type ServiceEvent } from './events.js';
import { Connection, type ConnectionOptions } from './http.js';
import { stream, type StreamEvent, type StreamOptions } from './stream.js';
import type {
  Asset, AssetSummary, Atlas, Edit, EditOptions, Filter, HistoryEntry, HistoryPage, Job, ObjectDetail, Samples, Scene,
  ScenePatch, ScenePlan, SceneSummary, Upload,
} from './types.js';
import { isOpen } from './types.js';

type Query = Record<string, string | number | boolean | readonly number[] | undefined>;

/** What a body is: a file says so by its name. */
export type Body = Blob | ArrayBuffer | Uint8Array<ArrayBuffer>;

const KINDS: Record<string, string> = {
  glb: 'model/gltf-binary',
  zip: 'application/zip',
  exr: 'image/x-exr',
  hdr: 'image/vnd.radiance',
};

/** The media type of a file, by its name; that of binary glTF where it has none. */
export function kindOf(body: Body, name = body instanceof Blob && 'name' in body ? String(body.name) : ''): string {
  return KINDS[name.split('.').at(-1)!.toLowerCase()] ?? KINDS['glb']!;
}

/** A service. */
export class Rebake {
  readonly connection: Connection;

  /** `base`: where the service is, like `http://127.0.0.1:7878`. */
  constructor(base: string | URL, options: ConnectionOptions = {}) {
    this.connection = new Connection(base, options);
  }

  // ---- scenes

  /** All scenes, newest first. */
  scenes = (): Promise<SceneSummary[]> => this.all<SceneSummary>('v1/scenes');

  scene = (scene: string): Promise<Scene> => this.json(of(scene));

  /** Uploads a file, which starts its bake. */
  upload = (file: Body, settings: Upload = {}, signal?: AbortSignal): Promise<Scene> =>
    this.json(`v1/scenes${search(asQuery(settings))}`, { ...binary(file), ...(signal && { signal }) });

  /** What a file would take; nothing is kept. */
  plan = (file: Body, settings: Upload = {}): Promise<ScenePlan> =>
    this.json(`v1/scenes${search({ ...asQuery(settings), dry_run: true })}`, binary(file));

  /** Waits until a scene that was just uploaded is laid out. */
  async prepared(scene: string): Promise<Scene> {
    for (;;) {
      const found = await this.scene(scene);
      if (found.state !== 'preparing') return found;
      await new Promise((done) => setTimeout(done, 200));
    }
  }

  /** Another name or target. */
  change = (scene: string, patch: ScenePatch): Promise<Scene> => this.json(of(scene), { method: 'PATCH', ...asJson(patch) });

  async delete(scene: string): Promise<void> {
    await this.send(of(scene), { method: 'DELETE' });
  }

  // ---- edits and jobs

  /** Sends edits as one request, which is applied as a whole or not at all; answers the job that lights it. */
  edit(scene: string, edits: Edit | Edit[], options: EditOptions = {}): Promise<Job> {
    const { ifMatch, idempotencyKey = crypto.randomUUID(), ...beside } = options;
    const sent = asJson(Array.isArray(edits) ? { edits, ...beside } : { ...edits, ...beside });
    const headers: Record<string, string> = { ...sent.headers, 'idempotency-key': idempotencyKey };
    if (ifMatch !== undefined) headers['if-match'] = `"${ifMatch}"`;
    return this.json(`${of(scene)}/edits`, { method: 'POST', body: sent.body, headers });
  }

  /** All edit requests of a scene, oldest first, and which ones `undo` and `redo` would concern. */
  async history(scene: string): Promise<HistoryPage> {
    const items: HistoryEntry[] = [];
    for (let cursor: string | undefined; ; ) {
      const page = await this.json<HistoryPage>(`${of(scene)}/edits${search({ limit: 200, cursor })}`);
      items.push(...page.items);
      if (!page.next_cursor) return { ...page, items };
      cursor = page.next_cursor;
    }
  }

  jobs = (scene?: string, state?: Job['state']): Promise<Job[]> => this.all<Job>('v1/jobs', { scene, state });
  job = (job: string): Promise<Job> => this.json(jobPath(job));
  async cancel(job: string): Promise<void> {
    await this.send(jobPath(job), { method: 'DELETE' });
  }
  pause = (job: string): Promise<Job> => this.json(`${jobPath(job)}/pause`, { method: 'POST' });
  resume = (job: string): Promise<Job> => this.json(`${jobPath(job)}/resume`, { method: 'POST' });

  /** Waits for the end of a job; `progress` hears of it meanwhile. Throws where it fails; a canceled one is answered. */
  async finished(job: string, progress: (job: Job) => void = () => {}, signal?: AbortSignal): Promise<Job> {
    for await (const event of follow(this.connection, `${jobPath(job)}/events`, signal)) {
      const now: Job = event.type === 'job' ? event.data : await this.job(job);
      progress(now);
      if (now.state === 'failed') throw new Error(now.error ?? 'The job failed.');
      if (!isOpen(now)) return now;
    }
    return this.job(job);
  }

  // ---- assets

  /** Uploads what edits insert (`.glb`) or a picture of the sky (`.exr`, `.hdr`); the same bytes have the same id. */
  asset = (file: Body, kind = kindOf(file)): Promise<Asset> => this.json('v1/assets', binary(file, kind));
  assets = (): Promise<AssetSummary[]> => this.all<AssetSummary>('v1/assets');
  async deleteAsset(asset: string): Promise<void> {
    await this.send(`v1/assets/${encodeURIComponent(asset)}`, { method: 'DELETE' });
  }

  // ---- light

  /** The whole light map as a file: `glb` (the subdivided mesh; `layout: 'atlas'`: own triangles with pages), `exr`, `raw`. */
  lightMap = (
    scene: string,
    query: { format?: 'glb' | 'exr' | 'raw'; layout?: 'vertices' | 'atlas'; layer?: string; part?: string; filter?: Filter } = {},
  ): Promise<ArrayBuffer> => this.bytes(`${of(scene)}/lightmap${search(query)}`);

  /** What changed since a version, in frames: see `readFrames`. */
  deltas = (scene: string, since: number, query: { layer?: string; part?: string; filter?: Filter } = {}): Promise<ArrayBuffer> =>
    this.bytes(`${of(scene)}/lightmap/deltas${search({ since, ...query })}`);

  /** Where objects lie in the atlas. */
  atlas = (scene: string): Promise<Atlas> => this.json(`${of(scene)}/atlas`);
  /** One page of it. `png` is to look at, `exr` to compute with. */
  atlasPage = (
    scene: string,
    page: number,
    query: { format?: 'exr' | 'png'; precision?: 'half' | 'float'; layer?: string; part?: string; filter?: Filter } = {},
  ): Promise<ArrayBuffer> => this.bytes(`${of(scene)}/atlas/${page}${search(query)}`);

  /** Tiles of the pages that changed since a version: see `readTiles` and `AtlasPages`. */
  atlasDeltas = (
    scene: string,
    since: number,
    query: { precision?: 'half' | 'float'; layer?: string; part?: string; filter?: Filter } = {},
  ): Promise<ArrayBuffer> => this.bytes(`${of(scene)}/atlas/deltas${search({ since, ...query })}`);

  object = (scene: string, object: string): Promise<ObjectDetail> => this.json(`${objectPath(scene, object)}?format=json`);
  /** One object's mesh and elements. */
  objectMesh = (scene: string, object: string): Promise<ArrayBuffer> => this.bytes(`${objectPath(scene, object)}?format=glb`);

  /** Light at points: x, y, z and the normal. */
  sample = (scene: string, points: number[][], samples?: number): Promise<Samples> =>
    this.json(`${of(scene)}/sample`, { method: 'POST', ...asJson({ points, ...(samples && { samples }) }) });

  /** A picture, or with `progressive` a multipart answer of better and better ones. */
  render = (scene: string, query: Query, signal?: AbortSignal): Promise<Response> =>
    this.send(`${of(scene)}/render${search(query)}`, signal && { signal });

  // ---- streams

  /** The light map as it changes, on this thread; `streamInWorker` does the same on another. */
  follow = (scene: string, options: StreamOptions = {}): AsyncGenerator<StreamEvent> => stream(this.connection, scene, options);

  /** `job`, `snapshot` and `scene` events for as long as one listens. */
  events = (scene: string, signal?: AbortSignal): AsyncGenerator<ServiceEvent> =>
    follow(this.connection, `${of(scene)}/events`, signal);

  // ---- plain requests

  send = (path: string, init?: RequestInit): Promise<Response> => this.connection.send(path, init);

  private async json<T>(path: string, init?: RequestInit): Promise<T> {
    return (await this.send(path, init)).json() as Promise<T>;
  }

  private async bytes(path: string): Promise<ArrayBuffer> {
    return (await this.send(path)).arrayBuffer();
  }

  private async all<T>(path: string, query: Query = {}): Promise<T[]> {
    const items: T[] = [];
    for (let cursor: string | undefined; ; ) {
      const page = await this.json<{ items: T[]; next_cursor?: string | null }>(`${path}${search({ ...query, cursor })}`);
      items.push(...page.items);
      if (!page.next_cursor) return items;
      cursor = page.next_cursor;
    }
  }
}

const of = (scene: string) => `v1/scenes/${encodeURIComponent(scene)}`;
const jobPath = (job: string) => `v1/jobs/${encodeURIComponent(job)}`;
const objectPath = (scene: string, object: string) => `${of(scene)}/objects/${encodeURIComponent(object)}`;

const asJson = (value: unknown) => ({ body: JSON.stringify(value), headers: { 'content-type': 'application/json' } });
const binary = (body: Body, kind = kindOf(body)): RequestInit => ({ method: 'POST', body, headers: { 'content-type': kind } });

function asQuery({ target, layers, ...plain }: Upload): Query {
  const asText = typeof layers === 'object' ? JSON.stringify(layers) : layers;
  return { ...plain, target: target && JSON.stringify(target), layers: asText };
}

function search(query: Query): string {
  const given = Object.entries(query).filter(([, value]) => value !== undefined);
  const text = new URLSearchParams(given.map(([name, value]) => [name, Array.isArray(value) ? value.join(',') : String(value)]));
  return given.length ? `?${text}` : '';
}
