// The HTTP API. Every refusal becomes an Error whose message a person can act on.

import { parts } from './parts';
import { askAgain, authorization } from './token';
import type { Edit, Job, Scene, SceneSummary, View } from './types';

/** The service said no. */
export class Refused extends Error {
  constructor(
    readonly status: number,
    readonly kind: string,
    message: string,
  ) {
    super(message);
  }
}

async function call(path: string, init?: RequestInit): Promise<Response> {
  const sent = authorization();
  let response: Response;
  try {
    response = await fetch(path, { ...init, headers: { ...init?.headers, ...sent } });
  } catch {
    throw new Error('The service does not answer.');
  }
  if (response.ok) return response;
  if (response.status === 401 && askAgain(sent)) return call(path, init);
  const problem = await response.json().catch(() => ({}));
  const text = [problem.title ?? response.statusText, problem.detail].filter(Boolean).join(': ');
  throw new Refused(response.status, problem.type ?? '', text);
}

const json = async <T>(path: string, init?: RequestInit): Promise<T> => (await call(path, init)).json();
const glb = (body: Blob): RequestInit => ({ method: 'POST', body, headers: { 'content-type': 'model/gltf-binary' } });
const of = (scene: string) => `v1/scenes/${encodeURIComponent(scene)}`;

export const api = {
  scenes: async () => (await json<{ items: SceneSummary[] }>('v1/scenes')).items,
  scene: (id: string) => json<Scene>(of(id)),
  upload: (file: Blob, name: string) => json<Scene>(`v1/scenes?name=${encodeURIComponent(name)}`, glb(file)),
  asset: async (file: Blob) => (await json<{ asset: string }>('v1/assets', glb(file))).asset,
  jobs: async (scene: string) => (await json<{ items: Job[] }>(`v1/jobs?scene=${encodeURIComponent(scene)}`)).items,
  cancel: async (job: string) => void (await call(`v1/jobs/${encodeURIComponent(job)}`, { method: 'DELETE' })),
  edit: (scene: string, edits: Edit[], focus: View) =>
    json<Job>(`${of(scene)}/edits`, {
      method: 'POST',
      headers: { 'content-type': 'application/json', 'idempotency-key': crypto.randomUUID() },
      body: JSON.stringify({ edits, focus }),
    }),
  mesh: async (scene: string) => (await call(`${of(scene)}/lightmap?format=glb`)).arrayBuffer(),
  layer: async (scene: string, layer: string) =>
    (await call(`${of(scene)}/lightmap?format=raw&layer=${encodeURIComponent(layer)}`)).arrayBuffer(),
  layerDelta: async (scene: string, layer: string, since: number) =>
    (await call(`${of(scene)}/lightmap/deltas?since=${since}&layer=${encodeURIComponent(layer)}`)).arrayBuffer(),
  deltas: (scene: string) => new URL(`${of(scene)}/lightmap/deltas`, document.baseURI).href,
  events: (scene: string) => `${of(scene)}/events`,
  /** Pictures from the page's own camera, each with more samples per pixel than the one before. */
  async *pictures(scene: string, view: string, camera: View, exposure: number, spp: number, signal: AbortSignal) {
    const query = new URLSearchParams({
      view,
      eye: camera.eye.join(','),
      target: camera.target.join(','),
      up: camera.up.join(','),
      fov_y: String(camera.fov_y),
      width: String(Math.min(camera.width, 1280)),
      height: String(Math.max(1, Math.round((camera.height * Math.min(camera.width, 1280)) / camera.width))),
      exposure: String(exposure),
      spp: String(spp),
      progressive: 'true',
    });
    const response = await call(`${of(scene)}/render?${query}`, { signal });
    for await (const { headers, bytes } of parts(response.body!)) {
      yield { blob: new Blob([bytes], { type: 'image/png' }), samples: headers.get('x-rebake-samples') };
    }
  },
};
