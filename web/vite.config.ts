import react from "@vitejs/plugin-react";
import { defineConfig } from "vitest/config";

/** Development only: where `npm run dev` finds a running `downrange server`. */
const server = process.env.DOWNRANGE_DEV_SERVER ?? "http://127.0.0.1:8000";

export default defineConfig({
  plugins: [react()],
  server: {
    proxy: {
      // The server takes requests of its own origin only.
      "/api": { target: server, ws: true, changeOrigin: true, headers: { origin: server } },
      "/viewer": { target: server, ws: true, changeOrigin: true, headers: { origin: server } },
    },
  },
  build: { target: "es2023", chunkSizeWarningLimit: 900 },
  test: {
    // A document costs most of a test file's time; only components need one.
    projects: [
      {
        extends: true,
        test: {
          name: "dom",
          environment: "happy-dom",
          include: ["src/**/*.test.tsx"],
          setupFiles: ["src/testing.setup.ts"],
          testTimeout: 60_000,
        },
      },
      {
        extends: true,
        test: { name: "logic", environment: "node", include: ["src/**/*.test.ts"] },
      },
    ],
  },
});
