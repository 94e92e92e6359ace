import { defineConfig } from 'vite';

// Everything in three files with fixed names: they are embedded into the binary and served with an entity tag.
export default defineConfig({
  base: './',
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
