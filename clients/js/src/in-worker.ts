// The light map's stream on a thread of its own.

import type { Rebake } from './client.js';
import type { StreamOptions } from './stream.js';
import type { FromWorker, ToWorker } from './worker.js';

/** A worker that runs `rebake/worker`. Bundlers that want to see the address make one themselves. */
export const makeWorker = (): Worker => new Worker(new URL('./worker.js', import.meta.url), { type: 'module' });

/** Has a worker follow a scene, in place of what it followed; what it says goes to `heard`. Answers what ends it. */
export function streamInWorker(
  worker: Worker,
  client: Rebake,
  scene: string,
  heard: (event: FromWorker) => void,
  options: Omit<StreamOptions, 'signal'> = {},
): () => void {
  const { base, token } = client.connection;
  worker.onmessage = ({ data }: MessageEvent<FromWorker>) => heard(data);
  worker.onerror = (event) => heard({ type: 'failed', why: event.message || 'The worker cannot be loaded.' });
  worker.postMessage({ base: base.href, token, scene, options } satisfies ToWorker);
  return () => {
    worker.onmessage = null;
    worker.postMessage(null);
  };
}
