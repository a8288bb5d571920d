// @vitest-environment happy-dom
import { describe, expect, it } from "vitest";
import { readKey, readNews, viewerSentence } from "./viewerMessages";

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
    expect(viewerSentence({ state: "ground", detail: "" })).toMatch(/machine is not drawn/);
    expect(viewerSentence({ state: "disconnected", detail: "" })).toMatch(/not live/);
    expect(viewerSentence({ state: "unsupported", detail: "No WebGL 2." })).toMatch(
      /^No WebGL 2. Use/,
    );
  });
});

describe("keys pressed in the 3D view", () => {
  const key = {
    source: "downrange-viewer",
    type: "keydown",
    init: { key: "S", code: "KeyS", shiftKey: true, repeat: false },
  };

  it("become keys of this document", () => {
    const event = readKey(key, own, own);
    expect(event).toMatchObject({ type: "keydown", code: "KeyS", shiftKey: true, ctrlKey: false });
    expect(event?.bubbles).toBe(true);
  });

  it("come from our own view only, and only as keys", () => {
    expect(readKey(key, "https://evil.example", own)).toBeNull();
    expect(readKey({ ...key, type: "click" }, own, own)).toBeNull();
    expect(readKey({ ...key, init: { key: "S" } }, own, own)).toBeNull();
    expect(readKey(drawn, own, own)).toBeNull();
    expect(readNews(key, own, own)).toBeNull();
  });
});
