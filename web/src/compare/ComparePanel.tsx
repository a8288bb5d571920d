import { Select } from "@mantine/core";
import { useState } from "react";
import { AccuracyChart } from "../charts/AccuracyChart";
import { GroupMark } from "../charts/GroupMark";
import { groupStyle } from "../charts/groups";
import { ImpactScatter } from "../charts/ImpactScatter";
import type { Schema } from "../session/client";
import { ScrollTable } from "../validation/ScrollTable";
import tables from "../validation/Validation.module.css";
import { errorWords } from "../words/errors";
import { fixed, unbroken } from "../words/format";
import classes from "./Compare.module.css";
import { type Comparison, useComparison } from "./useComparison";
import { differenceWords, quantityWords, valueWords, verdictWords } from "./words";

type Policy = Schema["PolicyView"];
type Source = Comparison["comparisons"][number];

const TITLES: Record<Source["source"], string> = {
  validation: "By validations",
  history: "By real throws",
};

/** Two versions that a person chooses, on shared axes, with what the throws say of their differences. */
export function ComparePanel({ policies }: { policies: readonly Policy[] }) {
  const [a, setA] = useState<string | null>(null);
  const [b, setB] = useState<string | null>(null);
  const comparison = useComparison(a, b);
  const first = policies.find((one) => one.policy_sha256 === a);
  const others = policies.filter((one) => one.mode === first?.mode && one.policy_sha256 !== a);
  const options = (of: readonly Policy[]) =>
    of.map((one) => ({
      value: one.policy_sha256,
      label: `${one.policy_id}, ${one.mode.toUpperCase()}`,
    }));
  const chooseFirst = (sha256: string | null) => {
    const mode = policies.find((one) => one.policy_sha256 === sha256)?.mode;
    const second = policies.find((one) => one.policy_sha256 === b);
    if (second?.mode !== mode || b === sha256) setB(null);
    setA(sha256);
  };
  if (policies.length < 2) return null;
  return (
    <section className={classes.panel} aria-label="Compare two versions">
      <h2>Compare two versions</h2>
      <p>The verdicts are about the second version.</p>
      <div className={classes.choice}>
        <Select
          label="First version"
          size="md"
          placeholder="Choose"
          data={options(policies)}
          value={a}
          onChange={chooseFirst}
        />
        <Select
          label="Second version"
          size="md"
          placeholder={a === null ? "Choose the first before" : "Choose"}
          disabled={a === null}
          data={options(others)}
          value={b}
          onChange={setB}
        />
      </div>
      {comparison.isError && <p className={tables.refusal}>{errorWords(comparison.error)}</p>}
      {comparison.data?.comparisons.map((one) => (
        <SourceView key={one.source} found={one} comparison={comparison.data} />
      ))}
    </section>
  );
}

function SourceView({ found, comparison }: { found: Source; comparison: Comparison }) {
  const title = TITLES[found.source];
  return (
    <section className={classes.panel} aria-label={title}>
      <h3>{title}</h3>
      <p>{found.basis}</p>
      {found.differences.length > 0 && <Differences found={found} comparison={comparison} />}
      {found.stats && found.stats.points.length > 0 && <Plots stats={found.stats} />}
    </section>
  );
}

function Differences({ found, comparison }: { found: Source; comparison: Comparison }) {
  const hasHeights = found.differences.some((row) => row.height_m !== 0);
  const title = TITLES[found.source];
  return (
    <ScrollTable label={`Differences ${title}`}>
      <caption>
        Equal versions get any better or worse in at most 5 of 100 comparisons. Lengths in m.
      </caption>
      <thead>
        <tr>
          <th scope="col">Range, m</th>
          {hasHeights && <th scope="col">Height, m</th>}
          <th scope="col">Quantity</th>
          <th scope="col">{comparison.a_policy_id}</th>
          <th scope="col">{comparison.b_policy_id}</th>
          <th scope="col">Second beside first</th>
          <th scope="col">Verdict</th>
        </tr>
      </thead>
      <tbody>
        {found.differences.map((row) => (
          <tr key={`${row.range_m} ${row.height_m} ${row.quantity}`}>
            <th scope="row">{fixed(row.range_m)}</th>
            {hasHeights && <td>{fixed(row.height_m, 1)}</td>}
            <td>{quantityWords(row.quantity)}</td>
            <td>{valueWords(row.quantity, row.a)}</td>
            <td>{valueWords(row.quantity, row.b)}</td>
            <td>{unbroken(differenceWords(row))}</td>
            <td data-look={row.verdict === "worse" || undefined}>{verdictWords(row)}</td>
          </tr>
        ))}
      </tbody>
    </ScrollTable>
  );
}

const nothing = () => undefined;

function Plots({ stats }: { stats: Schema["ThrowStats"] }) {
  return (
    <>
      <div className={classes.legend}>
        {stats.groups.map((group) => (
          <span key={group.group}>
            <GroupMark {...groupStyle(stats.groups, group.group)} />
            {group.label}
          </span>
        ))}
      </div>
      <div className={classes.plots}>
        <div className={classes.plot}>
          <ImpactScatter stats={stats} selected={null} onSelect={nothing} />
        </div>
        <div className={classes.plot}>
          <AccuracyChart stats={stats} axis="downrange" />
        </div>
        <div className={classes.plot}>
          <AccuracyChart stats={stats} axis="crossrange" />
        </div>
      </div>
    </>
  );
}
