import { cleanup, render, screen, within } from "@testing-library/react";
import { afterEach, describe, expect, it } from "vitest";
import type { Diagnosis } from "../words";
import { CauseTable } from "./CauseTable";
import { ChainFlow } from "./ChainFlow";
import { chainOf } from "./chain";
import { ReasonList } from "./ReasonList";

const HOSTILE = "<img src=x onerror=alert(1)>";

const found: Diagnosis = {
  verdict: "explained",
  sentence: "",
  gap: {},
  stages: [
    {
      stage: "release",
      miss_m: { downrange: -0.4, crossrange: 0.1 },
      share_ratio: 1,
      ci90_m: [-0.5, -0.3],
    },
  ],
  causes: [
    {
      effects: [
        {
          effect: "release_delay",
          parameters: { extra_delay_s: { value: 0.05, ci90: [0.04, 0.06], unit: "s" } },
        },
      ],
      probability: 0.97,
      name: "release delay",
    },
    { effects: [], probability: 0.03, name: "none" },
  ],
  evidence: {
    where: { stage: "release", joint: null },
    named: [
      { stage: "release", joint: null },
      { stage: "actuation", joint: "boom" },
    ],
  },
  plots: {},
};

afterEach(cleanup);

describe("the chain", () => {
  it("says metres with signs and words, and where the cause lies", () => {
    render(<ChainFlow chain={chainOf(found)} />);
    const stages = screen.getAllByRole("listitem");
    expect(stages.map((stage) => within(stage).getByRole("heading").textContent)).toEqual([
      "Actuationcause",
      "Swing",
      "Releasecause",
      "Flight",
      "Aim",
    ]);
    const release = stages[2] as HTMLElement;
    expect(release.textContent).toContain("−0.40 m short");
    expect(release.textContent).toContain("+0.10 m left");
    expect(
      within(release).getByRole("img", {
        name: "−0.40 m short, 90 % interval −0.50 m to −0.30 m",
      }),
    ).toBeTruthy();
    expect(stages[0]?.textContent).toContain("no term");
  });
});

describe("the causes", () => {
  it("are rows with probability, name and size", () => {
    const sizes = [{ name: "extra delay", value: "50.0 ms", interval: "40.0 to 60.0 ms" }];
    const words = [
      { title: "release delay", probability: "97 %", effects: [{ title: "release delay", sizes }] },
      { title: "no effect", probability: "3 %", effects: [] },
    ];
    render(<CauseTable causes={found.causes} words={words} />);
    const rows = screen.getAllByRole("row").slice(1);
    expect(rows.map((row) => row.textContent)).toEqual([
      "97 %release delayextra delay 50.0 ms (40.0 to 60.0 ms)",
      "3 %no effect",
    ]);
  });
});

describe("reasons", () => {
  it("show hostile names as text, and nothing where there is none", () => {
    const { container, rerender } = render(
      <ReasonList title="Refused logs" reasons={[{ name: HOSTILE, why: HOSTILE }]} isOpen />,
    );
    expect(container.querySelector("img")).toBeNull();
    expect(container.querySelector("details")?.open).toBe(true);
    expect(container.textContent).toContain(HOSTILE);
    rerender(<ReasonList title="Refused logs" reasons={[]} />);
    expect(container.textContent).toBe("");
  });
});
