// What several parts of the test need.

export const close = (a, b, within = 2e-3) => Math.abs(a - b) < within;
export const extent = ({ bounds: { min, max } }) => min.map((low, k) => max[k] - low);
export const middle = ({ bounds: { min, max } }) => min.map((low, k) => (low + max[k]) / 2);

/** An object of the scene as the page knows it. */
export const found = async ({ state }, name) => (await state()).scene.objects.find((o) => o.name === name);

export async function undo({ page, state, settled }, times = 1) {
  for (let k = 0; k < times; k++) {
    const { scene } = await state();
    await page.locator('#undo').click();
    await page.waitForFunction((n) => window.rebake.state().scene.accepted_edits > n, scene.accepted_edits);
    await page.waitForFunction(() => window.rebake.state().fresh);
  }
  await settled();
}
