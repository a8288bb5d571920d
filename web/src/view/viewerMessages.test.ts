import { describe, expect, it } from "vitest";
import { readNews, viewerSentence } from "./viewerMessages";

const own = "http://127.0.0.1:8000";
const drawn = { source: "downrange-viewer", state: "drawn", detail: "" };

describe("messages of the 3D view", () => {
  it("are read from our own origin only", () => {
    expect(readNews(drawn, own, own)).toEqual({ state: "drawn", detail: "" });
    expect(readNews(drawn, "https://evil.example", own)).toBeNull();
  });

  it.each([null, 7, "drawn", {}, { ...drawn, source: "other" }, { ...drawn, state: "loading" }])(
    "ignore %j",
    (data) => expect(readNews(data, own, own)).toBeNull(),
  );

  it("leave no sentence over a view that shows the truth", () => {
    expect(viewerSentence({ state: "drawn", detail: "" })).toBe("");
    expect(viewerSentence({ state: "disconnected", detail: "" })).toMatch(/not live/);
    expect(viewerSentence({ state: "unsupported", detail: "No WebGL 2." })).toMatch(
      /^No WebGL 2. Use/,
    );
  });
});
