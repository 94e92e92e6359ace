import { fileURLToPath } from 'node:url';
import { defineConfig } from 'vite';

const client = (file: string) => fileURLToPath(new URL(`../clients/js/src/${file}`, import.meta.url));

// Everything in three files with fixed names: they are embedded into the binary and served with an entity tag.
export default defineConfig({
  base: './',
  resolve: {
    // The client's sources, so that the page needs no build of them; with the page's own three.js.
    alias: [
      { find: /^rebake$/, replacement: client('index.ts') },
      { find: /^rebake\/(three|worker)$/, replacement: client('$1.ts') },
    ],
    dedupe: ['three'],
  },
  build: {
    target: 'es2023',
    chunkSizeWarningLimit: 1000,
    rolldownOptions: {
      output: { entryFileNames: 'viewer.js', assetFileNames: 'viewer[extname]', chunkFileNames: '[name].js' },
    },
  },
  worker: { format: 'es', rolldownOptions: { output: { entryFileNames: 'worker.js' } } },
  // `npm run dev` beside `rebake serve`.
  server: { proxy: { '/v1': 'http://127.0.0.1:7878' } },
});
