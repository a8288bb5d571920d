import { SegmentedControl } from "@mantine/core";
import { useEffect, useRef, useState } from "react";
import { useMachine } from "../machine/useMachine";
import { GateSentence } from "../operate/GateSentence";
import type { Machine } from "../session/live";
import { useLive } from "../session/liveStore";
import { SitePanel } from "../site/SitePanel";
import { useSite } from "../site/useSite";
import { useZones } from "../site/useZones";
import { ZonePanel } from "../site/ZonePanel";
import {
  type Corner,
  type Drawing,
  isComplete,
  newZone,
  withClick,
  type Zone,
} from "../site/zones";
import { CameraButtons } from "../view/CameraButtons";
import { useViewSlot } from "../view/slot";
import { useViewFollows, useViewRequest } from "../view/useView";
import { errorWords } from "../words/errors";
import classes from "./site.module.css";

/** Site: what stands around a machine and what is kept free; the list at the left, the yard at the right. */
export function SitePage() {
  const machine = useMachine();
  if (!machine) {
    return <GateSentence sentence="No machine is known yet. Fleet shows how one is added." />;
  }
  return <SiteOf key={machine.machine_id} machine={machine} />;
}

type Part = "objects" | "zones";

function SiteOf({ machine }: { machine: Machine }) {
  const [part, setPart] = useState<Part>("objects");
  const [drawing, setDrawing] = useState<Drawing | null>(null);
  const slot = useViewSlot<HTMLDivElement>();
  useViewFollows({
    machineId: machine.machine_id,
    isPicking: drawing !== null,
    pickFor: drawing ? "point" : "target",
  });
  return (
    <div className={classes.page}>
      <h1 className="visually-hidden">Site of {machine.machine_id}</h1>
      <div className={classes.side}>
        <SegmentedControl
          fullWidth
          className={classes.parts}
          aria-label="Part of the site"
          data={[
            { value: "objects", label: "Objects" },
            { value: "zones", label: "Zones" },
          ]}
          value={part}
          onChange={(value) => {
            setDrawing(null);
            setPart(value as Part);
          }}
        />
        {part === "objects" ? (
          <Objects machine={machine} />
        ) : (
          <ZonesOf machine={machine} drawing={drawing} onDrawing={setDrawing} />
        )}
      </div>
      <div className={classes.main}>
        <div ref={slot} className={classes.view} />
        <CameraButtons hasPreview={false} />
      </div>
    </div>
  );
}

function Objects({ machine }: { machine: Machine }) {
  const site = useSite(machine.machine_id);
  return (
    <>
      {site.data && <SitePanel machine={machine} site={site.data} />}
      {site.isError && !site.data && <GateSentence sentence={errorWords(site.error)} />}
    </>
  );
}

type ZonesProps = {
  machine: Machine;
  drawing: Drawing | null;
  onDrawing: (drawing: Drawing | null) => void;
};

/** The zones, with clicks in the view as corners, and the view shown what is drawn or changed. */
function ZonesOf({ machine, drawing, onDrawing }: ZonesProps) {
  const zones = useZones(machine.machine_id);
  const [draft, setDraft] = useState<Zone[] | null>(null);
  const [open, setOpen] = useState<number | null>(null);
  const picked = useLive((live) => live.picked[machine.machine_id]);
  const seen = useRef(picked);
  const request = useViewRequest();
  const known = zones.data?.zones;

  useEffect(() => {
    if (!picked || picked === seen.current) return;
    seen.current = picked;
    if (!drawing || !known) return;
    const next = withClick(drawing, picked.x_m, picked.y_m);
    if (!isComplete(next)) return onDrawing(next);
    const shown = draft ?? known;
    setDraft([...shown, newZone(next.corners, shown)]);
    setOpen(shown.length);
    onDrawing(null);
  }, [picked, drawing, known, draft, onDrawing]);

  const opened = open === null ? undefined : (draft ?? known)?.[open];
  const edited = draft && opened ? opened : undefined;
  const corners: Corner[] = drawing?.corners ?? (edited?.corners_m as Corner[]) ?? [];
  const sketch = JSON.stringify({
    corners_m: corners,
    bottom_m: edited?.bottom_m ?? 0,
    top_m: edited?.top_m ?? 3,
  });
  useEffect(() => request({ sketch: JSON.parse(sketch) }), [request, sketch]);
  useEffect(() => () => request({ sketch: { corners_m: [], bottom_m: 0, top_m: 3 } }), [request]);

  if (zones.isError && !zones.data) return <GateSentence sentence={errorWords(zones.error)} />;
  if (!zones.data) return null;
  return (
    <ZonePanel
      machine={machine}
      zones={zones.data}
      drawing={drawing}
      onDrawing={onDrawing}
      draft={draft}
      onDraft={setDraft}
      open={open}
      onOpen={setOpen}
    />
  );
}
