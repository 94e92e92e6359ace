// Server-sent events. EventSource cannot send a token, so they are read from a plain answer; after a lost connection it
// goes on behind the last event.

import { delay, pause, Refused, type Connection } from './http.js';

export interface ServiceEvent {
  /** `job`, `snapshot`, `scene`, or `reset` where events were lost: look at everything anew. */
  type: string;
  id: string;
  data: any;
}

/** Events for as long as one listens. Ends where the service no longer has what they are about, or lets nobody in. */
export async function* follow(from: Connection, path: string, signal?: AbortSignal): AsyncGenerator<ServiceEvent> {
  let last = '';
  for (let failures = 0; !signal?.aborted; ) {
    try {
      const headers: Record<string, string> = last ? { 'last-event-id': last } : {};
      const response = await from.send(path, { headers, ...(signal && { signal }) });
      failures = 0;
      for await (const event of readEvents(response.body!)) {
        last = event.id || last;
        if (signal?.aborted) return;
        yield { ...event, data: JSON.parse(event.data) };
      }
    } catch (error) {
      if (signal?.aborted) return;
      // It will not get better by itself.
      if (error instanceof Refused && [401, 403, 404].includes(error.status)) return;
    }
    await pause(delay(failures++), signal);
  }
}

/** The events of a `text/event-stream`. */
export async function* readEvents(body: ReadableStream<Uint8Array>): AsyncGenerator<{ type: string; id: string; data: string }> {
  const [stream, decoder] = [body.getReader(), new TextDecoder()];
  let text = '';
  try {
    for (;;) {
      const { done, value } = await stream.read();
      if (done) return;
      text += decoder.decode(value, { stream: true });
      for (let end = text.indexOf('\n\n'); end >= 0; end = text.indexOf('\n\n')) {
        const event = readEvent(text.slice(0, end));
        text = text.slice(end + 2);
        if (event.data) yield event;
      }
    }
  } finally {
    await stream.cancel().catch(() => {});
  }
}

function readEvent(text: string): { type: string; id: string; data: string } {
  const event = { type: 'message', id: '', data: '' };
  const data: string[] = [];
  for (const line of text.split('\n')) {
    const [, name, value] = /^(event|id|data):? ?(.*)$/.exec(line) ?? [];
    if (name === 'event') event.type = value!;
    else if (name === 'id') event.id = value!;
    else if (name === 'data') data.push(value!);
  }
  event.data = data.join('\n');
  return event;
}
