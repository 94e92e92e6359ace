// Server-sent events. EventSource cannot send a token, so they are read from a plain answer; after a lost connection it
// goes on behind the last event.

import { authorization } from './token';

type Heard = Record<string, (data: any) => void>;

export class Events {
  private readonly stop = new AbortController();

  constructor(
    private readonly path: string,
    private readonly heard: Heard,
  ) {
    void this.follow();
  }

  close(): void {
    this.stop.abort();
  }

  private async follow(): Promise<void> {
    const { signal } = this.stop;
    let last = '';
    for (let failures = 0; !signal.aborted; ) {
      try {
        const headers = { ...authorization(), ...(last && { 'last-event-id': last }) };
        const response = await fetch(this.path, { signal, headers });
        // It will not get better by itself.
        if ([401, 403, 404].includes(response.status)) return;
        if (!response.ok || !response.body) throw new Error(`the service answers ${response.status}`);
        failures = 0;
        for await (const event of read(response.body)) {
          last = event.id || last;
          if (!signal.aborted) this.heard[event.type]?.(JSON.parse(event.data));
        }
      } catch {
        if (signal.aborted) return;
      }
      await new Promise((resolve) => setTimeout(resolve, Math.min(250 * 2 ** failures++, 4000)));
    }
  }
}

async function* read(body: ReadableStream<Uint8Array>): AsyncGenerator<{ type: string; id: string; data: string }> {
  const [stream, decoder] = [body.getReader(), new TextDecoder()];
  let text = '';
  for (;;) {
    const { done, value } = await stream.read();
    if (done) return;
    text += decoder.decode(value, { stream: true });
    for (let end = text.indexOf('\n\n'); end >= 0; end = text.indexOf('\n\n')) {
      const event = { type: 'message', id: '', data: '' };
      for (const line of text.slice(0, end).split('\n')) {
        const [, name, value] = /^(event|id|data):? ?(.*)$/.exec(line) ?? [];
        if (name === 'event') event.type = value!;
        else if (name === 'id') event.id = value!;
        else if (name === 'data') event.data += value!;
      }
      text = text.slice(end + 2);
      if (event.data) yield event;
    }
  }
}
