import { afterEach, describe, expect, it, vi } from "vitest";
import { ApiError } from "../session/client";
import { filesRefusal, uploadPolicy } from "./upload";

const file = (name: string) => new File(["x"], name);
const WHOLE = ["policy.onnx", "card.json", "golden_vectors.json"].map(file);

const ENDLESS = new AbortController().signal;

/** A request that the test answers. */
class FakeRequest {
  static last: FakeRequest;
  upload: { onprogress?: (event: unknown) => void } = {};
  headers: Record<string, string> = {};
  status = 0;
  response: unknown = null;
  body: FormData | null = null;
  onload: () => void = () => {};
  onerror: () => void = () => {};
  onabort: () => void = () => {};
  constructor() {
    FakeRequest.last = this;
  }
  open(method: string, path: string) {
    expect([method, path]).toEqual(["POST", "/api/v1/policies"]);
  }
  setRequestHeader(name: string, value: string) {
    this.headers[name] = value;
  }
  send(body: FormData) {
    this.body = body;
  }
  abort() {
    this.onabort();
  }
  answer(status: number, response: unknown) {
    Object.assign(this, { status, response });
    this.onload();
  }
}

afterEach(() => vi.unstubAllGlobals());

describe("the files of a version", () => {
  it("are exactly three", () => {
    expect(filesRefusal(WHOLE)).toBeNull();
    expect(filesRefusal(WHOLE.slice(0, 1))).toMatch(
      /^card\.json and golden_vectors\.json are miss/,
    );
    expect(filesRefusal(WHOLE.slice(0, 2))).toMatch(/^golden_vectors\.json is missing/);
    expect(filesRefusal([...WHOLE, file("notes.txt")])).toMatch(/^notes\.txt does not belong/);
    expect(filesRefusal([...WHOLE, file("card.json")])).toBe("A file was chosen twice.");
  });
});

describe("an upload", () => {
  it("sends files and reason, and tells how far it is", async () => {
    vi.stubGlobal("XMLHttpRequest", FakeRequest);
    const seen: number[] = [];
    const done = uploadPolicy(WHOLE, "retrained", (ratio) => seen.push(ratio), ENDLESS);
    const request = FakeRequest.last;
    expect(request.headers["X-Requested-With"]).toBe("downrange");
    expect(request.body?.get("reason")).toBe("retrained");
    expect(request.body?.getAll("files").map((one) => (one as File).name)).toEqual(
      WHOLE.map((one) => one.name),
    );
    request.upload.onprogress?.({ lengthComputable: true, loaded: 1, total: 4 });
    request.answer(201, { policy_id: "v8" });
    await expect(done).resolves.toEqual({ policy_id: "v8" });
    expect(seen).toEqual([0.25]);
  });

  it("fails with the server's sentence, or that there is no answer", async () => {
    vi.stubGlobal("XMLHttpRequest", FakeRequest);
    const refused = uploadPolicy(WHOLE, "retrained", () => {}, ENDLESS);
    const message = "Another version is called v7 already.";
    FakeRequest.last.answer(409, { error: { code: "policy_name", message } });
    await expect(refused).rejects.toThrow(message);
    const lost = uploadPolicy(WHOLE, "retrained", () => {}, ENDLESS);
    FakeRequest.last.onerror();
    await expect(lost).rejects.toBeInstanceOf(ApiError);
  });

  it("ends where a person cancels it", async () => {
    vi.stubGlobal("XMLHttpRequest", FakeRequest);
    const running = new AbortController();
    const done = uploadPolicy(WHOLE, "retrained", () => {}, running.signal);
    running.abort();
    await expect(done).rejects.toThrow("Cancelled before all of it was sent.");
  });
});
