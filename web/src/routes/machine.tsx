import { Button, SegmentedControl, Select } from "@mantine/core";
import { useNavigate, useParams } from "@tanstack/react-router";
import { useMemo, useState } from "react";
import { AimPanel } from "../aim/AimPanel";
import { CommissioningPanel } from "../fleet/CommissioningPanel";
import { DossierPanel } from "../fleet/DossierPanel";
import { EditMachine } from "../fleet/EditMachine";
import classes from "../fleet/Fleet.module.css";
import {
  AlertsPanel,
  GapPanel,
  LifePanel,
  OnBoardPanel,
  ThrowsPanel,
} from "../fleet/MachinePanels";
import { MachineStop } from "../fleet/MachineStop";
import { RetireMachine } from "../fleet/RetireMachine";
import { SetUpPanel } from "../fleet/SetUp";
import { TrendChart } from "../fleet/TrendChart";
import { chosenPoints, chosenVersions, type Mode, rangeBins } from "../fleet/trend";
import { type MachineLife, useMachineLife } from "../fleet/useFleet";
import { Lamp } from "../machine/Lamp";
import { useMachineId } from "../machine/useMachine";
import { GateSentence } from "../operate/GateSentence";
import type { Machine } from "../session/live";
import { useLive } from "../session/liveStore";
import { useMay } from "../session/useSession";
import { errorWords } from "../words/errors";
import { count } from "../words/format";

/** One machine: what it does now, how well it throws over time, and what it has been through. */
export function MachinePage() {
  const { machineId } = useParams({ from: "/frame/machines/$machineId" });
  const machine = useLive((live) => live.machines[machineId]);
  const isLoaded = useLive((live) => live.isLoaded);
  const life = useMachineLife(machineId);
  if (life.isError) return <GateSentence sentence={errorWords(life.error)} />;
  if (isLoaded && !machine) {
    return <GateSentence sentence={`There is no machine ${machineId} in the fleet.`} />;
  }
  if (!machine || !life.data) return null;
  return (
    <div className={classes.page}>
      <Head machine={machine} life={life.data} />
      <Trend life={life.data} />
      <AimPanel machineId={machineId} />
      <div className={classes.panels}>
        <OnBoardPanel machineId={machineId} />
        <LifePanel machine={machine} life={life.data} />
        <SetUpPanel machineId={machineId} isConnected={machine.link.is_connected} />
        <AlertsPanel machineId={machineId} />
        <ThrowsPanel machineId={machineId} />
        <GapPanel machineId={machineId} />
        <CommissioningPanel machineId={machineId} />
        <DossierPanel machineId={machineId} />
      </div>
    </div>
  );
}

function Head({ machine, life }: { machine: Machine; life: MachineLife }) {
  const [isOpen, setOpen] = useState(false);
  const [isRetiring, setRetiring] = useState(false);
  const mayEdit = useMay("machine.edit");
  const mayRetire = useMay("machine.enrol");
  const isConnected = machine.link.is_connected;
  const [, choose] = useMachineId();
  const navigate = useNavigate();
  const id = machine.machine_id;
  const operate = () => {
    choose(id);
    void navigate({ to: "/operate" });
  };
  return (
    <header className={classes.head}>
      <h1>{machine.name || id}</h1>
      {machine.name && <span className={classes.dim}>{id}</span>}
      {life.tags.length > 0 && <span className={classes.dim}>{life.tags.join(", ")}</span>}
      <Lamp machine={machine} />
      <span className={classes.spread} />
      <Button variant="default" size="sm" disabled={!mayEdit} onClick={() => setOpen(true)}>
        Name and tags
      </Button>
      {mayRetire && (
        <Button
          variant="default"
          size="sm"
          disabled={isConnected}
          onClick={() => setRetiring(true)}
        >
          Retire
        </Button>
      )}
      <Button variant="default" size="sm" onClick={operate}>
        Operate
      </Button>
      <MachineStop machineId={id} />
      {!mayEdit && <p className={classes.why}>A supervisor may change name and tags.</p>}
      {mayRetire && isConnected && (
        <p className={classes.why}>To retire it, switch the machine off first.</p>
      )}
      {isRetiring && (
        <RetireMachine
          machineId={id}
          onClose={() => setRetiring(false)}
          onDone={() => void navigate({ to: "/fleet" })}
        />
      )}
      {isOpen && (
        <EditMachine
          machineId={id}
          name={machine.name}
          tags={life.tags}
          onClose={() => setOpen(false)}
        />
      )}
    </header>
  );
}

function Trend({ life }: { life: MachineLife }) {
  const newest = life.trend.at(-1)?.mode ?? "2d";
  const [chosen, setChosen] = useState<Mode | null>(null);
  const [binWords, setBin] = useState<string | null>(null);
  const mode = chosen ?? newest;
  const bins = useMemo(() => rangeBins(life.trend.filter((p) => p.mode === mode)), [life, mode]);
  const bin = bins.find((one) => one.words === binWords) ?? null;
  const points = useMemo(() => chosenPoints(life.trend, mode, bin), [life, mode, bin]);
  const versions = useMemo(() => chosenVersions(life.versions, points, mode), [life, points, mode]);
  if (life.trend.length === 0) {
    return <p className={classes.dim}>No throw of this machine has been measured yet.</p>;
  }
  const note = `${count(points.length, "throw")}${life.is_trend_cut ? ", the newest" : ""}; line: running median; dashed: another version`;
  return (
    <section aria-label="Accuracy over time">
      <div className={classes.head}>
        <SegmentedControl
          aria-label="Mode"
          data={[
            { value: "2d", label: "2D" },
            { value: "3d", label: "3D" },
          ]}
          value={mode}
          onChange={(value) => setChosen(value as Mode)}
        />
        <Select
          size="sm"
          clearable
          aria-label="Target range"
          placeholder="All ranges"
          classNames={{ root: classes.field }}
          data={bins.map((one) => one.words)}
          value={bin?.words ?? null}
          onChange={setBin}
        />
      </div>
      <div className={classes.panels}>
        {(["downrange", "crossrange"] as const).map((axis) => (
          <div key={axis} className={classes.chart}>
            <TrendChart axis={axis} points={points} versions={versions} note={note} />
          </div>
        ))}
      </div>
    </section>
  );
}
