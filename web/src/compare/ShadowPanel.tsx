import { Button, NumberInput, Select } from "@mantine/core";
import { Link } from "@tanstack/react-router";
import { useState } from "react";
import type { Schema } from "../session/client";
import { useMay } from "../session/useSession";
import { ScrollTable } from "../validation/ScrollTable";
import tables from "../validation/Validation.module.css";
import { errorWords } from "../words/errors";
import { fixed } from "../words/format";
import classes from "./Compare.module.css";
import shadow from "./Shadow.module.css";
import { ShadowPlot } from "./ShadowPlot";
import {
  letGoWords,
  measuredOf,
  missWords,
  pairWords,
  type Shadow,
  summaryWords,
  useShadow,
} from "./shadow";

type Props = { policies: readonly Schema["PolicyView"][]; machineId: string };

/** A version run over the machine's recorded throws: what it would have done. Nothing moves. */
export function ShadowPanel({ policies, machineId }: Props) {
  const [sha256, setSha256] = useState<string | null>(null);
  const [count, setCount] = useState(12);
  const run = useShadow();
  const may = useMay("policy.validate");
  const present = policies.filter((one) => one.is_present);
  const start = () => {
    if (sha256) run.mutate({ sha256, machine_id: machineId, throws_count: count });
  };
  const asked = present.find((one) => one.policy_sha256 === sha256);
  return (
    <section className={classes.panel} aria-label="Shadow">
      <h2>Shadow</h2>
      <p>
        Runs a version over recorded throws of {machineId}: what it would have done there. Nothing
        moves.
      </p>
      <div className={classes.choice}>
        <Select
          label="Version"
          size="md"
          placeholder="Choose"
          data={present.map((one) => ({
            value: one.policy_sha256,
            label: `${one.policy_id}, ${one.mode.toUpperCase()}`,
          }))}
          value={sha256}
          onChange={setSha256}
        />
        <NumberInput
          label="Newest throws"
          size="md"
          min={1}
          max={48}
          allowDecimal={false}
          clampBehavior="strict"
          value={count}
          onChange={(value) => setCount(Number(value) || 1)}
        />
        <Button
          size="md"
          variant="default"
          loading={run.isPending}
          disabled={!may || sha256 === null}
          onClick={start}
        >
          Run
        </Button>
      </div>
      {!may && <p>Engineers may run it.</p>}
      {run.isPending && (
        <p role="status">
          {asked?.policy_id} throws in the twin; some seconds, a minute on a busy server.
        </p>
      )}
      {run.isError && (
        <p className={tables.refusal} role="alert">
          {errorWords(run.error)}
        </p>
      )}
      {run.data && !run.isPending && <Result found={run.data} />}
    </section>
  );
}

function Result({ found }: { found: Shadow }) {
  return (
    <>
      <p>
        {summaryWords(found)}
        {!found.is_registered &&
          ` ${found.machine_id} is not registered with ${found.policy_id}: its mean miss would be smaller after registration.`}
      </p>
      <ShadowPlot found={found} />
      <ScrollTable label="Throws in shadow">
        <caption>
          Misses along, across in m. Velocity: root mean square of the difference of the commands up
          to the release, of a range of 2. Let go: shown the same, beside the version that flew.
        </caption>
        <thead>
          <tr>
            <th scope="col">Throw</th>
            <th scope="col">Range, m</th>
            <th scope="col">Velocity</th>
            <th scope="col">Let go</th>
            <th scope="col">{found.policy_id} in the twin</th>
            <th scope="col">What flew, in the twin</th>
            <th scope="col">Measured</th>
          </tr>
        </thead>
        <tbody>
          {found.throws.map((one) => (
            <tr key={one.throw_id}>
              <th scope="row">
                <Link
                  className={shadow.link}
                  to="/throws/$throwId"
                  params={{ throwId: one.throw_id }}
                >
                  {one.throw_id.slice(-8)}
                </Link>
              </th>
              <td>{fixed(Math.hypot(one.target.x_m, one.target.y_m))}</td>
              <td>{fixed(one.action_difference_rms_ratio)}</td>
              <td>{letGoWords(one)}</td>
              <td>{missWords(one.candidate)}</td>
              <td>{missWords(one.flown)}</td>
              <td>{pairWords(measuredOf(one), "not measured")}</td>
            </tr>
          ))}
        </tbody>
      </ScrollTable>
      {found.left_out.length > 0 && (
        <ul>
          {found.left_out.map(([id, reason]) => (
            <li key={id}>
              {id.slice(-8)} left out: {reason}.
            </li>
          ))}
        </ul>
      )}
    </>
  );
}
