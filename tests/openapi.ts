// Types that openapi-typescript made of the description: tests/openapi.sh checks that this compiles with them.
import type { components, paths } from "./api";

type Edit = components["schemas"]["SingleEdit"];

export const undo: Edit = { op: "undo", budget: { max_seconds: 2 } };
export const move: Edit = { op: "move", object: "sofa", transform: [1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1] };
export const request: components["schemas"]["EditRequest"] = { edits: [move, undo], priority: "high" };
export type Delta = paths["/v1/scenes/{scene}/lightmap/deltas/{from}-{to}"]["get"];

/** The tag tells edits apart. */
export const asset = (edit: Edit): string | null => (edit.op === "insert" ? edit.asset : null);
export const lamp: components["schemas"]["NewLight"] = { kind: "point", position: [0, 2, 0], color: [1, 1, 1], intensity: 40 };

// @ts-expect-error: there is no such edit.
export const odd: Edit = { op: "jump" };
// @ts-expect-error: an edit needs its fields.
export const half: Edit = { op: "remove" };
