import { describe, expect, it } from "vitest";
import { ApiError, take, toApiError } from "../session/client";
import { errorCode, errorWords } from "./errors";

describe("errorWords", () => {
  it("keeps the server's numbers and adds the console's next step", () => {
    const error = new ApiError(409, "no_lease", "Nobody holds m001");
    expect(errorWords(error)).toBe("Nobody holds m001. Take control first.");
  });

  it("does not repeat a remedy the server already gave", () => {
    const text = "Refused: gripper empty. Load first.";
    expect(errorWords(new ApiError(409, "no_payload", text))).toBe(text);
  });

  it("passes unknown codes through", () => {
    const text = "Refused: target 11.40 m, 2D reaches 10.90 m.";
    expect(errorWords(new ApiError(422, "target_out_of_reach", text))).toBe(text);
  });

  it("hides programming faults behind one sentence", () => {
    expect(errorWords(new TypeError("x is undefined"))).toMatch(/Reload/);
    expect(errorCode(new TypeError("x"))).toBe("internal");
  });
});

describe("take", () => {
  it("returns data of a good answer", async () => {
    const response = new Response("{}", { status: 200 });
    await expect(take(Promise.resolve({ data: 7, response }))).resolves.toBe(7);
  });

  it("names the offline case", async () => {
    const failed = take(Promise.reject(new TypeError("fetch failed")));
    await expect(failed).rejects.toMatchObject({ code: "offline", status: 0 });
  });

  it("reads the one error shape, and survives any other", async () => {
    const body = { error: { code: "busy", message: "m001 is throwing.", detail: null } };
    expect(toApiError(409, body)).toMatchObject({ code: "busy", message: "m001 is throwing." });
    expect(toApiError(502, "<html>")).toMatchObject({ code: "http_502" });
  });
});
