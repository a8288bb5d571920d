import { Button, NumberInput, Select, TextInput } from "@mantine/core";
import { Link } from "@tanstack/react-router";
import { useState } from "react";
import { useMachineId } from "../machine/useMachine";
import type { Schema } from "../session/client";
import { useLive } from "../session/liveStore";
import { useMay } from "../session/useSession";
import { ScrollTable } from "../validation/ScrollTable";
import tables from "../validation/Validation.module.css";
import { errorWords } from "../words/errors";
import { fixed } from "../words/format";
import { dayStart, localStamp, zoneName } from "../words/time";
import classes from "./Compare.module.css";
import shadow from "./Shadow.module.css";
import { ShadowPlot } from "./ShadowPlot";
import {
  figureWords,
  letGoWords,
  measuredOf,
  missWords,
  pairWords,
  type Shadow,
  summaryWords,
  throwsWords,
  useShadow,
  useShadowRun,
  useShadows,
} from "./shadow";

type Props = { policies: readonly Schema["PolicyView"][] };

const ALL = "";

/** A version run over recorded throws: what it would have done. Nothing moves; each run is kept. */
export function ShadowPanel({ policies }: Props) {
  const [here] = useMachineId();
  const machineIds = useLive((live) => Object.keys(live.machines).sort().join(" "));
  const [sha256, setSha256] = useState<string | null>(null);
  const [machineId, setMachineId] = useState<string | null>(null);
  const [since, setSince] = useState("");
  const [until, setUntil] = useState("");
  const [count, setCount] = useState(12);
  const [shown, setShown] = useState<string | null>(null);
  const run = useShadow();
  const may = useMay("policy.validate");
  const present = policies.filter((one) => one.is_present);
  const chosen = machineId ?? here ?? ALL;
  const start = () => {
    if (!sha256) return;
    setShown(null);
    run.mutate(
      {
        sha256,
        machine_id: chosen === ALL ? null : chosen,
        since_utc: since ? dayStart(since) : null,
        until_utc: until ? dayStart(until, true) : null,
        throws_count: count,
      },
      { onSuccess: (done) => setShown(done.shadow_id) },
    );
  };
  const choose = (value: string | null) => {
    setSha256(value);
    setShown(null);
    run.reset();
  };
  const asked = present.find((one) => one.policy_sha256 === sha256);
  return (
    <section className={classes.panel} aria-label="Shadow">
      <h2>Shadow</h2>
      <p>Runs a version over recorded throws: what it would have done there. Nothing moves.</p>
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
          onChange={choose}
        />
        <Select
          label="Throws of"
          size="md"
          allowDeselect={false}
          data={[
            { value: ALL, label: "All machines" },
            ...machineIds.split(" ").filter((id) => id !== ""),
          ]}
          value={chosen}
          onChange={(value) => setMachineId(value ?? ALL)}
        />
        <TextInput
          type="date"
          label="Since"
          size="md"
          value={since}
          onChange={(event) => setSince(event.currentTarget.value)}
        />
        <TextInput
          type="date"
          label="Until"
          size="md"
          value={until}
          onChange={(event) => setUntil(event.currentTarget.value)}
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
      {shown !== null && <Shown shadowId={shown} />}
      {sha256 !== null && <Runs sha256={sha256} shown={shown} onShow={setShown} />}
    </section>
  );
}

function Shown({ shadowId }: { shadowId: string }) {
  const found = useShadowRun(shadowId);
  if (found.isError)
    return (
      <p className={tables.refusal} role="alert">
        {errorWords(found.error)}
      </p>
    );
  return found.data ? <Result found={found.data.report} /> : null;
}

type RunsProps = { sha256: string; shown: string | null; onShow: (shadowId: string) => void };

/** What was run of a version before. */
function Runs({ sha256, shown, onShow }: RunsProps) {
  const runs = useShadows(sha256);
  if (runs.isError)
    return (
      <p className={tables.refusal} role="alert">
        {errorWords(runs.error)}
      </p>
    );
  if (!runs.data) return null;
  if (runs.data.length === 0) return <p>It was not run in shadow yet.</p>;
  return (
    <ScrollTable label="Shadows that were run">
      <caption>
        Runs, newest first ({zoneName(new Date())}). Mean misses in the twin along, across in m, of
        the throws that land.
      </caption>
      <thead>
        <tr>
          <th scope="col">When</th>
          <th scope="col">Throws of</th>
          <th scope="col">The version</th>
          <th scope="col">What flew</th>
          <th scope="col">Velocity</th>
          <th scope="col">Who</th>
          <th scope="col">Throws</th>
        </tr>
      </thead>
      <tbody>
        {runs.data.map((one) => (
          <tr key={one.shadow_id} aria-current={one.shadow_id === shown}>
            <th scope="row">{localStamp(one.created_utc)}</th>
            <td>{throwsWords(one)}</td>
            <td>{figureWords(one.figures.candidate)}</td>
            <td>{figureWords(one.figures.flown)}</td>
            <td>{fixed(one.figures.action_difference_rms_ratio)}</td>
            <td>{one.created_by}</td>
            <td>
              <Button
                size="xs"
                variant="default"
                disabled={one.shadow_id === shown}
                aria-label={`Show the shadow of ${localStamp(one.created_utc)}`}
                onClick={() => onShow(one.shadow_id)}
              >
                Show
              </Button>
            </td>
          </tr>
        ))}
      </tbody>
    </ScrollTable>
  );
}

function Result({ found }: { found: Shadow }) {
  return (
    <>
      <p>
        {summaryWords(found)}
        {found.unregistered_ids.length > 0 &&
          ` Not registered with ${found.policy_id}: ${found.unregistered_ids.join(", ")}; mean misses there would be smaller after registration.`}
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
            <th scope="col">Machine</th>
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
              <td>{one.machine_id}</td>
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
