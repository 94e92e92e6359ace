// What the page says: one line of status, and a banner for what a person has to know.

import { Refused } from 'rebake';
import { $, button } from './dom';

export function say(text: string): void {
  $('status').textContent = text;
}

/** A message that stays until it no longer holds, with what can be done about it. */
export function banner(text: string | null, calm = false, actions: Record<string, () => void> = {}): void {
  $('banner').hidden = text === null;
  $('banner').classList.toggle('calm', calm);
  const buttons = Object.entries(actions).map(([name, action]) =>
    button(name, () => {
      banner(null);
      action();
    }),
  );
  $('banner').replaceChildren(text ?? '', ...buttons);
}

let timer = 0;

/** Runs something that may fail, and says how. `refused` runs where the service refused it. */
export async function attempting(what: () => Promise<unknown>, refused: () => Promise<unknown>): Promise<void> {
  try {
    await what();
  } catch (error) {
    const text = error instanceof Error ? error.message : String(error);
    banner(text);
    clearTimeout(timer);
    // Unless something else is said by then.
    timer = window.setTimeout(() => $('banner').textContent === text && banner(null), 8000);
    if (error instanceof Refused && error.status !== 404) await refused().catch(() => {});
  }
}

/** Keeps what the page measures in its last line. */
export function showNumbers(frameMs: () => number): void {
  setInterval(() => {
    const { mesh, stream } = $('numbers').dataset;
    const frame = frameMs() ? `frame ${frameMs().toFixed(0)} ms` : '';
    $('numbers').textContent = [mesh, stream, frame].filter(Boolean).join(' · ');
  }, 500);
}
