import { TextInput } from "@mantine/core";
import { useNavigate, useSearch } from "@tanstack/react-router";
import { useCallback, useMemo, useState } from "react";
import { AccuracyChart } from "../charts/AccuracyChart";
import { ImpactScatter } from "../charts/ImpactScatter";
import { GateSentence } from "../operate/GateSentence";
import type { Throw } from "../session/live";
import { CompareTable } from "../throws/CompareTable";
import { FilterBar } from "../throws/FilterBar";
import { type GroupBy, isFiltered, parseSearch, type ThrowsSearch } from "../throws/filters";
import { found } from "../throws/find";
import { GroupTable } from "../throws/GroupTable";
import { PageButtons } from "../throws/PageButtons";
import { ThrowTable } from "../throws/ThrowTable";
import { useThrowPage, useThrowStats } from "../throws/useThrows";
import { errorWords } from "../words/errors";
import classes from "./throws.module.css";

const MOST_COMPARED = 4;
const NO_ROWS: readonly Throw[] = [];

/** Throws: the history at the left, what it says about accuracy at the right, one selection. */
export function ThrowsPage() {
  const search = useSearch({ from: "/frame/throws" });
  const navigate = useNavigate({ from: "/throws" });
  const [selected, setSelected] = useState<string | null>(null);
  const [text, setText] = useState("");
  const [compared, setCompared] = useState<readonly Throw[]>([]);
  const compare = useCallback(
    (row: Throw, isCompared: boolean) =>
      setCompared((old) => {
        const others = old.filter((one) => one.throw_id !== row.throw_id);
        // Of more than fit side by side the first one goes.
        return isCompared ? [...others, row].slice(-MOST_COMPARED) : others;
      }),
    [],
  );
  const { cursor, group = "policy", ...filters } = search;
  const page = useThrowPage(filters, cursor);
  const stats = useThrowStats(filters, group);
  const go = (change: Partial<ThrowsSearch>, replace = false) =>
    void navigate({ search: (old) => parseSearch({ ...old, ...change }), replace });
  const all = page.data?.rows ?? NO_ROWS;
  const rows = useMemo(() => found(all, text), [all, text]);
  return (
    <div className={classes.page}>
      <h1 className="visually-hidden">Throws</h1>
      <FilterBar
        filters={filters}
        onChange={(change) => go({ ...change, cursor: undefined }, true)}
        onClear={() => void navigate({ search: parseSearch({ group }) })}
      />
      <div className={classes.body}>
        <section className={classes.history} aria-label="History">
          {page.isError && <GateSentence sentence={errorWords(page.error)} />}
          {page.data && all.length === 0 && (
            <GateSentence
              sentence={
                isFiltered(filters)
                  ? "No throw matches these filters. Clear one."
                  : "No throw yet. Operate makes the first one."
              }
            />
          )}
          {all.length > 0 && (
            <TextInput
              size="xs"
              m={8}
              aria-label="Find on this page"
              placeholder="Find on this page: time, machine, outcome, policy, person"
              value={text}
              onChange={(event) => setText(event.currentTarget.value)}
            />
          )}
          {all.length > 0 && rows.length === 0 && (
            <GateSentence sentence="No throw of this page has these words." />
          )}
          {rows.length > 0 && (
            <ThrowTable
              rows={rows}
              selected={selected}
              onSelect={setSelected}
              compared={compared.map((row) => row.throw_id)}
              onCompare={compare}
            />
          )}
          <PageButtons
            rowCount={all.length}
            isFirst={!cursor}
            nextCursor={page.data?.next_cursor ?? null}
            onCursor={(next) => go({ cursor: next })}
          />
        </section>
        {stats.data && stats.data.groups.length > 0 && (
          <section className={classes.charts} aria-label="Accuracy">
            {compared.length > 1 && (
              <CompareTable throws={compared} onClear={() => setCompared([])} />
            )}
            <GroupTable
              stats={stats.data}
              groupBy={group}
              onGroupBy={(by: GroupBy) => go({ group: by }, true)}
            />
            <div className={classes.large}>
              <ImpactScatter stats={stats.data} selected={selected} onSelect={setSelected} />
            </div>
            <div className={classes.small}>
              <AccuracyChart stats={stats.data} axis="downrange" />
            </div>
            <div className={classes.small}>
              <AccuracyChart stats={stats.data} axis="crossrange" />
            </div>
          </section>
        )}
      </div>
    </div>
  );
}
