import { describe, expect, it } from "vitest";
import { surveyOf } from "./survey";

describe("a survey on its way", () => {
  it("goes as text or as bytes, and not at all where it is too large", async () => {
    expect(await surveyOf(null)).toBeNull();
    const text = new File(["x_m,y_m,z_m"], "ground.CSV");
    expect(await surveyOf(text)).toEqual({ survey_csv: "x_m,y_m,z_m" });
    const bytes = new Uint8Array(70_000).map((_, at) => at % 251);
    const sent = await surveyOf(new File([bytes], "ground.tif"));
    expect(sent).toEqual({ survey_base64: Buffer.from(bytes).toString("base64") });
    await expect(surveyOf(new File([new Uint8Array(6_000_001)], "a.laz"))).rejects.toThrow(
      "6.0 MB",
    );
  });
});
