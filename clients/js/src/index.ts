// A client of rebake. `rebake/three` puts live light maps on three.js scenes.

export { Rebake, kindOf, type Body } from './client.js';
export { readEvents, type ServiceEvent } from './events.js';
export { ElementMap, FrameReader, HALF, LAST, REPLACE, apply, reach, readFrames, type Frame } from './frames.js';
export { Connection, Refused, Unreachable, type ConnectionOptions } from './http.js';
export { makeWorker, streamInWorker } from './in-worker.js';
export { readVertices, readsOf, type Reads } from './reads.js';
export { stream, type Snapshot, type StreamEvent, type StreamOptions } from './stream.js';
export { AtlasPages, readTiles, type AtlasTexels, type Place, type Tile, type TileFrame } from './tiles.js';
export type { FromWorker } from './worker.js';
export * from './types.js';
