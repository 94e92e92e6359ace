// What is asked before an upload: how fine, which light, how far; with what it would take.

import type { Budget, ScenePlan, Upload } from 'rebake';
import { client } from './api';
import { fromHex } from './colors';
import { $, baseName, make } from './dom';

const field = (id: string) => $<HTMLInputElement | HTMLSelectElement>(`up-${id}`);
const value = (id: string): number | undefined => {
  const number = Number(field(id).value);
  return field(id).value.trim() && number > 0 ? number : undefined;
};

/** The picture that is chosen for the sky, as an asset. */
let sky: { file: File; asset: Promise<string> } | null = null;

async function skyAsset(): Promise<string | undefined> {
  const file = (field('sky-picture') as HTMLInputElement).files?.[0];
  if (!file) return undefined;
  if (sky?.file !== file) sky = { file, asset: client.asset(file).then(({ asset }) => asset) };
  try {
    return await sky.asset;
  } catch (error) {
    // It is sent again the next time.
    sky = null;
    throw error;
  }
}

/** The settings as they stand in the form; what is left empty is the service's to choose. */
async function settings(): Promise<Upload> {
  const target: Budget = {};
  const [samples, time, error] = [value('samples'), value('seconds'), value('error')];
  if (samples) target.samples_per_element = Math.round(samples);
  if (time) target.max_seconds = time;
  if (error) target.target_rmse = error;
  const [spacing, texels] = [value('spacing'), value('texels')];
  const made: Upload = {
    name: field('name').value,
    mode: field('mode').value as 'full' | 'indirect',
    unit: field('unit').value as 'candela' | 'watt',
  };
  if (spacing) made.spacing = spacing;
  if (texels) made.texels_per_metre = texels;
  if (Object.keys(target).length) made.target = target;
  const kind = field('sky').value;
  const strength = value('sky-strength') ?? 1;
  if (kind === 'default') made.default_sky = true;
  else if (kind === 'colour') made.environment = fromHex(field('sky-colour').value)!.map((c) => c * strength) as [number, number, number];
  else if (kind === 'picture') {
    const picture = await skyAsset();
    if (picture) Object.assign(made, { sky: picture, sky_strength: strength, sky_rotation: Number(field('sky-rotation').value) || 0 });
  }
  return made;
}

/** Asks; answers the settings, or null where it was thought better of. */
export function ask(file: File): Promise<Upload | null> {
  const dialog = $<HTMLDialogElement>('upload-dialog');
  const form = dialog.querySelector('form')!;
  field('name').value = baseName(file);
  $('up-file').textContent = `${file.name}, ${(file.size / 1e6).toFixed(1)} MB`;
  let request = 0;
  let timer = 0;
  const estimate = async () => {
    const mine = ++request;
    const kind = field('sky').value;
    $('up-sky-of-colour').hidden = kind !== 'colour';
    $('up-sky-of-picture').hidden = kind !== 'picture';
    $('up-sky-more').hidden = kind !== 'colour' && kind !== 'picture';
    $('up-plan').ariaBusy = 'true';
    $('up-plan').replaceChildren('Looking at the file …');
    try {
      const wanted = await settings();
      const plan = await client.plan(file, wanted);
      if (mine === request) $('up-plan').replaceChildren(...describe(plan, wanted));
    } catch (error) {
      if (mine !== request) return;
      $('up-plan').replaceChildren(make('strong', { class: 'bad' }, error instanceof Error ? error.message : String(error)));
    }
    if (mine === request) $('up-plan').ariaBusy = 'false';
  };
  form.oninput = () => {
    clearTimeout(timer);
    // What is on its way is about other settings.
    request++;
    $('up-plan').ariaBusy = 'true';
    timer = window.setTimeout(() => void estimate(), 300);
  };
  void estimate();
  dialog.returnValue = '';
  dialog.showModal();
  return new Promise((answer, refuse) => {
    dialog.onclose = () => {
      request++;
      clearTimeout(timer);
      if (dialog.returnValue === 'ok') settings().then(answer, refuse);
      else answer(null);
    };
  });
}

function describe(plan: ScenePlan, { default_sky, environment, sky }: Upload): HTMLElement[] {
  const count = (n: number) => n.toLocaleString('en');
  const lines = [
    `${count(plan.elements)} elements, one per ${plan.spacing.toPrecision(2)} m; ${count(Math.ceil(plan.memory_bytes / 1e6))} MB of memory`,
    `${count(plan.objects)} objects, ${count(plan.lights)} lights`,
  ];
  if (plan.lights === 0 && !default_sky && !environment && !sky) lines.push('There is no light in it: choose a sky above, or add lamps later.');
  return [...lines, ...plan.warnings].map((line) => make('p', {}, line));
}
