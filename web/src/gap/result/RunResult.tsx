import { useMemo } from "react";
import { type Diagnosis, type DiagnosisWords, type Run, SENTENCES } from "../words";
import { ApplyPanel } from "./ApplyPanel";
import { CauseTable } from "./CauseTable";
import { ChainFlow } from "./ChainFlow";
import { chainOf } from "./chain";
import { GapPlots } from "./GapPlots";
import { ReasonList } from "./ReasonList";
import classes from "./RunResult.module.css";
import { refusedOf } from "./refused";
import { ShrinkBars } from "./ShrinkBars";

type Props = { run: Run; found: Diagnosis; words: DiagnosisWords };

/** A finished diagnosis from top to bottom: where, which, how far, what to do. */
export function RunResult({ run, found, words }: Props) {
  const chain = useMemo(() => chainOf(found), [found]);
  const motion = found.ambiguity?.separating_motion.words;
  return (
    <div className={classes.result}>
      {found.stages.length > 0 && (
        <Section title={SENTENCES.section_where}>
          <ChainFlow chain={chain} />
        </Section>
      )}
      {found.causes.length > 0 && (
        <Section title={SENTENCES.section_which}>
          <CauseTable causes={found.causes} words={words.causes} />
        </Section>
      )}
      {found.ambiguity && (
        <Section title={SENTENCES.section_next}>
          <p>{words.undecided}</p>
          <p>
            <strong>{String(motion ?? "")}</strong>
          </p>
        </Section>
      )}
      {found.shrink && (
        <Section title={SENTENCES.section_shrink}>
          <ShrinkBars found={found} words={words.shrink} />
        </Section>
      )}
      {run.effect_count > 0 && (
        <Section title="Apply">
          <ApplyPanel run={run} found={found} words={words} />
        </Section>
      )}
      {found.verdict !== "bad_data" && (
        <Section title={SENTENCES.section_plots}>
          <GapPlots plots={found.plots} />
        </Section>
      )}
      <Section title="Reasons">
        <ReasonList
          title={SENTENCES.section_refused}
          reasons={refusedOf(found.evidence)}
          isOpen={found.verdict === "bad_data"}
        />
        <ReasonList title={SENTENCES.section_ruled_out} reasons={words.ruled_out} />
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
