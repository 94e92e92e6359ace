// Follows one scene's light map: fetches, checks and decodes frames away from the page's thread, and comes back by
// itself after a lost connection, with the last version it has. Snapshots are handed over whole.

import { FrameReader, LAST, type Frame } from './frames';

export type FromWorker =
  | { type: 'snapshot'; frames: Frame[]; version: number; elements: number; bytes: number; ms: number }
  | { type: 'offline'; why: string }
  | { type: 'online' }
  | { type: 'gone' };

let running: AbortController | undefined;

addEventListener('message', ({ data }: MessageEvent<{ url: string; headers: Record<string, string> } | null>) => {
  running?.abort();
  if (!data) return;
  running = new AbortController();
  void follow(data.url, data.headers, running.signal);
});

const post = (message: FromWorker, transfer: Transferable[] = []) => postMessage(message, { transfer });
const pause = (ms: number) => new Promise((resolve) => setTimeout(resolve, ms));

async function follow(url: string, headers: Record<string, string>, signal: AbortSignal): Promise<void> {
  let since = 0;
  for (let failures = 0; !signal.aborted; ) {
    try {
      const response = await fetch(`${url}?since=${since}&follow=true`, { signal, headers });
      if (response.status === 404) return post({ type: 'gone' });
      if (response.status === 409) {
        // Another life of the service counts its versions anew.
        since = 0;
        continue;
      }
      if (!response.ok || !response.body) throw new Error(`the service answers ${response.status}`);
      post({ type: 'online' });
      failures = 0;
      for await (const version of snapshots(response.body)) since = version;
      throw new Error('the stream ended');
    } catch (error) {
      if (signal.aborted) return;
      post({ type: 'offline', why: error instanceof Error ? error.message : String(error) });
      await pause(Math.min(250 * 2 ** failures++, 4000));
    }
  }
}

/** Hands over snapshot after snapshot; yields their versions. */
async function* snapshots(body: ReadableStream<Uint8Array>): AsyncGenerator<number> {
  const reader = new FrameReader();
  const stream = body.getReader();
  let [frames, bytes, elements, ms]: [Frame[], number, number, number] = [[], 0, 0, 0];
  for (;;) {
    const { done, value } = await stream.read();
    if (done) return;
    const start = performance.now();
    bytes += value.length;
    const decoded = reader.push(value);
    ms += performance.now() - start;
    for (const frame of decoded) {
      frames.push(frame);
      elements += frame.values.length / 3;
      if (!(frame.flags & LAST)) continue;
      const version = frame.version;
      const transfer = frames.map((f) => f.values.buffer);
      post({ type: 'snapshot', frames, version, elements, bytes, ms }, transfer);
      [frames, bytes, elements, ms] = [[], 0, 0, 0];
      yield version;
    }
  }
}
