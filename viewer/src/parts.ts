// A progressive picture: parts of a multipart body, each with its length, each better than the one before.

export interface Part {
  headers: Headers;
  bytes: Uint8Array<ArrayBuffer>;
}

/** The parts as they arrive; an error where the body ends before its last one. */
export async function* parts(body: ReadableStream<Uint8Array>): AsyncGenerator<Part> {
  const stream = body.getReader();
  let held = new Uint8Array();
  for (;;) {
    const next = split(held);
    if (next === 'end') return;
    if (next) {
      held = held.subarray(next.used);
      yield next.part;
      continue;
    }
    const { done, value } = await stream.read();
    if (done) throw new Error('The picture broke off.');
    const both = new Uint8Array(held.length + value.length);
    both.set(held);
    both.set(value, held.length);
    held = both;
  }
}

/** The first part of some bytes; null where it is not complete. */
function split(bytes: Uint8Array): { part: Part; used: number } | 'end' | null {
  // What is before the picture is short and plain: boundary, head, empty line.
  const text = new TextDecoder('latin1').decode(bytes.subarray(0, 4096));
  const boundary = /^(?:\r\n)?(--[^\r]+)\r\n/.exec(text);
  if (!boundary) return null;
  if (boundary[1]!.endsWith('--')) return 'end';
  const close = text.indexOf('\r\n\r\n', boundary[0].length);
  if (close < 0) return null;
  const headers = new Headers();
  for (const line of text.slice(boundary[0].length, close).split('\r\n')) {
    const colon = line.indexOf(':');
    headers.set(line.slice(0, colon), line.slice(colon + 1).trim());
  }
  const from = close + 4;
  const end = from + Number(headers.get('content-length'));
  return bytes.length < end ? null : { part: { headers, bytes: bytes.slice(from, end) }, used: end };
}
