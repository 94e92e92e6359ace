// A scene's light map as it changes: snapshots, whole, in order, also over lost connections.

import { FrameReader, LAST, type Frame } from './frames.js';
import { Connection, delay, pause, Refused } from './http.js';
import type { Filter } from './types.js';

/** All frames between two versions that are shown. */
export interface Snapshot {
  type: 'snapshot';
  frames: Frame[];
  version: number;
  /** Values in it, bytes on the wire, and milliseconds that decoding took. */
  elements: number;
  bytes: number;
  ms: number;
}

/** What a stream tells beside snapshots: how the connection is. `gone`: the service has no such scene; nothing follows. */
export type StreamEvent = Snapshot | { type: 'online' } | { type: 'offline'; why: string } | { type: 'gone' };

export interface StreamOptions {
  /** Version of the map that one has; 0 where absent: everything. */
  since?: number;
  layer?: string;
  part?: 'full' | 'direct' | 'indirect' | 'error';
  /** `statistical`: with noise averaged away where the errors allow it. `since` is of values that were filtered alike. */
  filter?: Filter;
  precision?: 'full' | 'half';
  signal?: AbortSignal;
}

/** Follows a scene for as long as one listens. Throws [Refused] where the service does not let one in. */
export async function* stream(from: Connection, scene: string, options: StreamOptions = {}): AsyncGenerator<StreamEvent> {
  const { signal, since: start = 0, ...rest } = options;
  const query = new URLSearchParams({ follow: 'true' });
  for (const [name, value] of Object.entries(rest)) if (value !== undefined) query.set(name, value);
  let since = start;
  for (let failures = 0; !signal?.aborted; ) {
    let why = 'the stream ended';
    try {
      query.set('since', String(since));
      const path = `v1/scenes/${encodeURIComponent(scene)}/lightmap/deltas?${query}`;
      const response = await from.send(path, signal && { signal });
      yield { type: 'online' };
      failures = 0;
      for await (const snapshot of snapshots(response.body!)) {
        since = snapshot.version;
        yield snapshot;
      }
    } catch (error) {
      if (signal?.aborted) return;
      if (error instanceof Refused) {
        if (error.status === 404) return yield { type: 'gone' };
        if ([400, 401, 403, 422].includes(error.status)) throw error;
        // Another life of the service counts its versions anew.
        if (error.status === 409 && since > 0) {
          since = 0;
          continue;
        }
      }
      why = error instanceof Error ? error.message : String(error);
    }
    if (signal?.aborted) return;
    yield { type: 'offline', why };
    await pause(delay(failures++), signal);
  }
}

async function* snapshots(body: ReadableStream<Uint8Array>): AsyncGenerator<Snapshot> {
  const reader = new FrameReader();
  const bytes = body.getReader();
  const empty = (): Snapshot => ({ type: 'snapshot', frames: [], version: 0, elements: 0, bytes: 0, ms: 0 });
  let next = empty();
  try {
    for (;;) {
      const { done, value } = await bytes.read();
      if (done) return;
      const start = performance.now();
      const frames = reader.push(value);
      next.bytes += value.length;
      next.ms += performance.now() - start;
      for (const frame of frames) {
        next.frames.push(frame);
        next.elements += frame.values.length / 3;
        if (!(frame.flags & LAST)) continue;
        yield { ...next, version: frame.version };
        next = empty();
      }
    }
  } finally {
    await bytes.cancel().catch(() => {});
  }
}
