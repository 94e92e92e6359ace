// The service, as the page reaches it: the client of clients/js, with a token that is asked of the person and kept for
// this tab.

import { Rebake, type Point } from 'rebake';
import { parts } from './parts';

const KEY = 'rebake-token';

/** A camera, as `focus` and `/render` take it. */
export interface View {
  eye: Point;
  target: Point;
  up: Point;
  fov_y: number;
  width: number;
  height: number;
}

export const client = new Rebake(document.baseURI.replace(/[#?].*$/, ''), {
  token: sessionStorage.getItem(KEY),
  askToken(tried) {
    const about = tried ? 'The service does not know this token. Another one:' : 'The service asks for a token:';
    const given = prompt(about)?.trim() || null;
    if (given) sessionStorage.setItem(KEY, given);
    return given;
  },
});

/** Pictures from the page's own camera, each with more samples per pixel than the one before. */
export async function* pictures(scene: string, view: string, camera: View, exposure: number, spp: number, signal: AbortSignal) {
  const width = Math.min(camera.width, 1280);
  const height = Math.max(1, Math.round((camera.height * width) / camera.width));
  const query = { ...camera, view, width, height, exposure, spp, progressive: true };
  const response = await client.render(scene, query, signal);
  for await (const { headers, bytes } of parts(response.body!)) {
    yield { blob: new Blob([bytes], { type: 'image/png' }), samples: headers.get('x-rebake-samples') };
  }
}
