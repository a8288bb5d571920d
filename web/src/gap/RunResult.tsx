import { useMemo } from "react";
import { ApplyPanel } from "./ApplyPanel";
import { CauseTable } from "./CauseTable";
import { ChainFlow } from "./ChainFlow";
import { chainOf } from "./chain";
import { GapPlots } from "./GapPlots";
import { ReasonList } from "./ReasonList";
import classes from "./RunResult.module.css";
import { refusedOf, ruledOutOf } from "./ruledOut";
import { ShrinkBars } from "./ShrinkBars";
import type { Diagnosis, Run } from "./words";

type Props = { run: Run; found: Diagnosis };

/** A finished diagnosis from top to bottom: where, which, how far, what to do. */
export function RunResult({ run, found }: Props) {
  const chain = useMemo(() => chainOf(found), [found]);
  const motion = found.ambiguity?.separating_motion.words;
  return (
    <div className={classes.result}>
      {found.stages.length > 0 && (
        <Section title="Where">
          <ChainFlow chain={chain} />
        </Section>
      )}
      {found.causes.length > 0 && (
        <Section title="Which">
          <CauseTable causes={found.causes} />
        </Section>
      )}
      {found.ambiguity && (
        <Section title="Next motion">
          <p>
            Undecided: {found.ambiguity.members.join(" or ")}; {found.ambiguity.why}.
          </p>
          <p>
            <strong>{String(motion ?? "")}</strong>
          </p>
        </Section>
      )}
      {found.shrink && (
        <Section title="How far it shrinks">
          <ShrinkBars found={found} />
        </Section>
      )}
      {run.effect_count > 0 && (
        <Section title="Apply">
          <ApplyPanel run={run} found={found} />
        </Section>
      )}
      {found.verdict !== "bad_data" && (
        <Section title="Measured against twin">
          <GapPlots plots={found.plots} />
        </Section>
      )}
      <Section title="Reasons">
        <ReasonList
          title="Refused logs"
          reasons={refusedOf(found.evidence)}
          isOpen={found.verdict === "bad_data"}
        />
        <ReasonList title="Ruled out" reasons={ruledOutOf(found.evidence)} />
        <p className={classes.dim}>All evidence stands in the report.</p>
      </Section>
    </div>
  );
}

function Section({ title, children }: { title: string; children: React.ReactNode }) {
  return (
    <section className={classes.section} aria-label={title}>
      <h2>{title}</h2>
      {children}
    </section>
  );
}
