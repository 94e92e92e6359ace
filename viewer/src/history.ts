// The scene's edit requests, as the service has them.

import type { HistoryPage } from 'rebake';
import { $, make } from './dom';
import { deeds, describe } from './requests';

const SHOWN = 40;

/** The list, newest first, and what the buttons would take back or make again. */
export function showHistory(page: HistoryPage | null): void {
  const list = $('history');
  const shown = JSON.stringify([page?.items.at(-1)?.sequence, page?.items.length, page?.undo, page?.redo]);
  if (list.dataset['shown'] !== shown || !page) list.replaceChildren(...rowsOf(page));
  list.dataset['shown'] = shown;
  for (const [id, sequence] of [['undo', page?.undo], ['redo', page?.redo]] as const) {
    const entry = page?.items.find((item) => item.sequence === sequence);
    const of = $<HTMLButtonElement>(id);
    of.disabled = !entry;
    of.title = entry ? `${id}: ${describe(entry.request)}` : `nothing to ${id}`;
  }
}

function rowsOf(page: HistoryPage | null): HTMLElement[] {
  const rows = (page ? deeds(page) : []).slice(-SHOWN).reverse().map((entry) => {
    const row = make('li', {}, describe(entry.request));
    row.classList.toggle('faint', entry.undone);
    if (entry.undone) row.append(make('small', {}, ' undone'));
    if (entry.accepted_at) row.title = new Date(entry.accepted_at).toLocaleString();
    if (entry.sequence === page?.undo) row.setAttribute('aria-current', 'step');
    return row;
  });
  return rows.length ? rows : [make('li', { class: 'quiet' }, 'No edits yet.')];
}
