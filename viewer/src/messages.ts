// What the page says: one line of status, and a banner for what a person has to know.

import { Refused } from 'rebake';
import { $ } from './panels';

export function say(text: string): void {
  $('status').textContent = text;
}

/** A message that stays until it no longer holds. */
export function banner(text: string | null, calm = false): void {
  $('banner').hidden = text === null;
  $('banner').classList.toggle('calm', calm);
  $('banner').textContent = text ?? '';
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
