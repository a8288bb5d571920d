import { describe, expect, it } from "vitest";
import { stateWords } from "./KeysPanel";
import type { SiteKey } from "./usePolicyLife";

const KEY: SiteKey = {
  key_id: "aee8c7cfc9369330",
  public_key: "",
  is_signing: false,
  is_revoked: false,
  since_utc: null,
  made_by: "server",
  revoked_utc: null,
  revoked_by: null,
  approval_count: 0,
  machine_ids: [],
};

describe("state of a site's key", () => {
  it("says whether it signs, is trusted still, or was revoked and by whom", () => {
    expect(stateWords({ ...KEY, is_signing: true })).toBe("Signs");
    expect(stateWords(KEY)).toBe("Trusted, signs no more");
    const revoked = { ...KEY, is_revoked: true };
    expect(stateWords(revoked)).toBe("Revoked");
    expect(
      stateWords({ ...revoked, revoked_utc: "2026-11-28T05:31:16Z", revoked_by: "ada" }),
    ).toMatch(/^Revoked 2026-11-28 .* by ada$/);
  });
});
