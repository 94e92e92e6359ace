// The running job, and those that wait.

import { isOpen, type Job, type Scene, type LightError } from 'rebake';
import { $, button, make } from './dom';

export interface WorkActions {
  cancel(job: Job): void;
  pause(job: Job): void;
  resume(job: Job): void;
  /** Lights what a canceled job has left. */
  light(): void;
}

const seconds = (ms: number) => (ms < 9950 ? `${(ms / 1000).toFixed(1)} s` : `${Math.round(ms / 1000)} s`);

export function work(jobs: Job[], scene: Scene | null, actions: WorkActions): void {
  const current = jobs.find((job) => job.state === 'running') ?? jobs.find((job) => job.state === 'paused' && job.pause_requested);
  const focused = (document.activeElement as HTMLElement | null)?.closest('#job') ? document.activeElement?.textContent : null;
  const parts = current ? open(current, actions) : rest(jobs, scene, actions);
  const buttons = [current?.id, ...parts.flatMap((part) => [...part.querySelectorAll('button')].map((one) => one.textContent))].join();
  const panel = $('job');
  // Buttons that are the same stay: a click that has begun is not lost when progress comes.
  if (current && panel.dataset['buttons'] === buttons) parts.slice(0, -1).forEach((part, k) => panel.children[k]!.replaceWith(part));
  else panel.replaceChildren(...parts);
  panel.dataset['buttons'] = buttons;
  const again = [...$('job').querySelectorAll('button')].find((one) => one.textContent === focused);
  again?.focus();
  const waiting = jobs.filter((job) => isOpen(job) && job !== current).reverse();
  const how = (job: Job) => (job.state === 'paused' ? 'is paused' : job.merged_into ? 'is done with the one that runs' : 'waits');
  const shown = JSON.stringify(waiting.map((job) => [job.id, job.state, job.merged_into, job.pause_requested]));
  // A click that has begun is not lost when progress comes.
  if ($('queue').dataset['shown'] === shown) return;
  $('queue').dataset['shown'] = shown;
  const items = waiting.map((job) => {
    const buttons = job.pause_requested ? [button('Continue', () => actions.resume(job))] : [];
    return make('li', {}, make('span', {}, `${job.kind} ${how(job)}`), ...buttons, button('Cancel', () => actions.cancel(job)));
  });
  $('queue').replaceChildren(...items);
}

/** What the distance between elements adds to the noise. */
const beside = ({ resolution = null }: LightError) => (resolution === null ? '' : `, of resolution ${resolution.toPrecision(3)}`);

function open(job: Job, actions: WorkActions): HTMLElement[] {
  const { fraction, elapsed_ms, remaining_ms: left = null, estimated_rmse: rmse = null, light_error, pass, samples_per_element } = job.progress;
  const error = rmse === null ? 'no light yet' : `stated error ${rmse.toPrecision(3)}${beside(light_error)}`;
  const text = [
    `${job.kind}, ${job.state === 'paused' ? 'paused' : (pass ?? 'starting').replace('_', ' ')}`,
    `${samples_per_element} samples per element, ${error}`,
    `${seconds(elapsed_ms)} gone${left === null ? '' : `, about ${seconds(left)} left`}`,
  ];
  const bar = make('progress', { max: '1', 'aria-label': 'Progress' });
  bar.value = fraction;
  const stop = button(job.cancel_requested ? 'Stopping…' : 'Cancel', () => actions.cancel(job), 'bad');
  stop.disabled = job.cancel_requested;
  const hold = job.pause_requested ? button('Continue', () => actions.resume(job)) : button('Pause', () => actions.pause(job));
  return [bar, ...text.map((line) => make('p', { class: 'quiet' }, line)), make('div', { class: 'actions' }, hold, stop)];
}

function rest(jobs: Job[], scene: Scene | null, actions: WorkActions): HTMLElement[] {
  const last = jobs.find((job) => !isOpen(job));
  const how = last && { failed: `failed: ${last.error ?? ''}`, canceled: 'was canceled' }[last.state as string];
  const rmse = scene?.estimated_rmse ?? null;
  const fine = rmse === null ? 'Nothing to do.' : rmse === 0 ? 'Up to date.' : `Up to date, stated error ${rmse.toPrecision(3)}${beside(scene!.light_error)}.`;
  const isUnlit = Boolean(scene?.unlit_edits) && !jobs.some(isOpen);
  const text = [how ? `The last job ${how}.` : isUnlit ? '' : fine, isUnlit ? `${scene!.unlit_edits === 1 ? 'One edit is' : `${scene!.unlit_edits} edits are`} not in the light yet.` : ''];
  const paragraph = make('p', { class: 'quiet' }, text.filter(Boolean).join(' '));
  return isUnlit ? [paragraph, button('Continue', actions.light)] : [paragraph];
}

/** Jobs with what is new of one. An answer to a request may come after an event that is newer than it. */
export function merge(jobs: Job[], job: Job): Job[] {
  const rank = { queued: 0, paused: 0, running: 1, succeeded: 2, failed: 2, canceled: 2 };
  const known = jobs.find((one) => one.id === job.id);
  if (!known) return [job, ...jobs];
  const isNewer = rank[job.state] >= rank[known.state] || (job.state === 'paused' && isOpen(known));
  return isNewer ? jobs.map((one) => (one === known ? job : one)) : jobs;
}
