// Follows a scene away from the page's thread: fetches, checks and decodes there, and hands frames over without a copy.
// It is told where by [streamInWorker], which also hears what it says.

import { Connection } from './http.js';
import { stream, type StreamEvent, type StreamOptions } from './stream.js';

export interface ToWorker {
  base: string;
  token: string | null;
  scene: string;
  options: Omit<StreamOptions, 'signal'>;
}

export type FromWorker = StreamEvent | { type: 'failed'; why: string };

let running: AbortController | undefined;

addEventListener('message', ({ data }: MessageEvent<ToWorker | null>) => {
  running?.abort();
  if (!data) return;
  running = new AbortController();
  void run(data, running.signal);
});

async function run({ base, token, scene, options }: ToWorker, signal: AbortSignal): Promise<void> {
  try {
    for await (const event of stream(new Connection(base, { token }), scene, { ...options, signal })) {
      if (signal.aborted) return;
      const transfer = event.type === 'snapshot' ? event.frames.map((frame) => frame.values.buffer) : [];
      postMessage(event satisfies FromWorker, { transfer: [...new Set(transfer)] });
    }
  } catch (error) {
    postMessage({ type: 'failed', why: error instanceof Error ? error.message : String(error) } satisfies FromWorker);
  }
}
