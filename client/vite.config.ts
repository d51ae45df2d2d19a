import { defineConfig } from "vitest/config";

export default defineConfig({
  base: "./",
  build: {
    outDir: "../src/avrgym/vr/static",
    emptyOutDir: true,
    assetsInlineLimit: 0,
    modulePreload: { polyfill: false },
    chunkSizeWarningLimit: 1000,
    rolldownOptions: { input: ["index.html", "dashboard.html", "caregiver.html", "replay.html", "participate.html", "host.html", "demonstrator.html"] },
    license: { fileName: "licenses.md" },
  },
  test: { include: ["tests/**/*.test.ts"], testTimeout: 600_000 },
});
