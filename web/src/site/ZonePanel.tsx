import { Button, TextInput } from "@mantine/core";
import { IconPolygon, IconTrash } from "@tabler/icons-react";
import { useState } from "react";
import type { Machine } from "../session/live";
import { useMay, useSession } from "../session/useSession";
import { errorWords } from "../words/errors";
import { zonedStamp } from "../words/time";
import classes from "./SitePanel.module.css";
import { useZoneActions } from "./useZones";
import { ZoneForm } from "./ZoneForm";
import {
  type Drawing,
  forceWords,
  isSame,
  newZone,
  type Zone,
  type Zones,
  zoneWords,
} from "./zones";

type Props = {
  machine: Machine;
  zones: Zones;
  /** What is being drawn in the view; the page around takes the clicks. */
  drawing: Drawing | null;
  onDrawing: (drawing: Drawing | null) => void;
  draft: Zone[] | null;
  onDraft: (draft: Zone[] | null) => void;
  open: number | null;
  onOpen: (index: number | null) => void;
};

/** The zones around a machine: drawn, changed, saved as a draft, approved. */
export function ZonePanel(props: Props) {
  const { machine, zones, drawing, onDrawing, draft, onDraft, open, onOpen } = props;
  // The version that the draft was begun with: a change by somebody else must be seen first.
  const [from, setFrom] = useState(zones.version_count);
  const [reason, setReason] = useState("");
  const { save, undo, approve } = useZoneActions(machine.machine_id);
  const mayEdit = useMay("site.edit");
  const approves = useMay("zones.approve");
  const me = useSession()?.username;
  const isOwn = me !== undefined && zones.drawn_by.includes(me);
  const mayApprove = approves && !(zones.is_four_eyes && isOwn);
  const shown = draft ?? zones.zones;
  const isChanged = draft !== null && !isSame(draft, zones.zones);
  const change = (next: Zone[]) => {
    if (draft === null) setFrom(zones.version_count);
    onDraft(next);
  };
  const discard = () => {
    onDraft(null);
    onDrawing(null);
    setReason("");
    for (const action of [save, undo, approve]) action.reset();
  };
  const finish = () => {
    if (!drawing) return;
    change([...shown, newZone(drawing.corners, shown)]);
    onOpen(shown.length);
    onDrawing(null);
  };
  const submit = (event: React.FormEvent) => {
    event.preventDefault();
    if (draft)
      save.mutate({ zones: draft, from_version_count: from, reason }, { onSuccess: discard });
  };
  const error = save.error ?? undo.error ?? approve.error;
  return (
    <form className={classes.panel} onSubmit={submit} aria-label="Exclusion zones">
      <header className={classes.head}>
        <h2>Kept free around {machine.machine_id}</h2>
        <p className={classes.note} data-testid="zones-in-force">
          {forceWords(zones, machine.state?.zones_sha256, machine.machine_id)}
        </p>
        {!zones.is_approved && (
          <p className={classes.note}>
            Draft: version {zones.version_count} by {zones.drawn_by.join(", ")},{" "}
            {zonedStamp(zones.changed_utc)}: {zones.reason}
          </p>
        )}
      </header>
      <ul className={classes.list}>
        {shown.map((zone, index) => (
          // biome-ignore lint/suspicious/noArrayIndexKey: names change while they are typed
          <li className={classes.object} key={index}>
            <div className={classes.line}>
              <button
                type="button"
                className={classes.name}
                aria-expanded={open === index}
                onClick={() => onOpen(open === index ? null : index)}
              >
                <IconPolygon size={20} stroke={1.7} aria-label="zone" />
                <span className={classes.title}>{zone.name}</span>
                <span className={classes.place}>{zoneWords(zone)}</span>
              </button>
              <Button
                variant="subtle"
                color="gray"
                disabled={!mayEdit}
                aria-label={`Delete ${zone.name}`}
                onClick={() => {
                  change(shown.filter((_, other) => other !== index));
                  onOpen(null);
                }}
              >
                <IconTrash size={18} aria-hidden />
              </Button>
            </div>
            {open === index && (
              <ZoneForm
                zone={zone}
                isDisabled={!mayEdit}
                onChange={(next) => change(shown.map((o, i) => (i === index ? next : o)))}
              />
            )}
          </li>
        ))}
      </ul>
      {drawing ? (
        <div className={classes.foot} role="status">
          <p className={classes.note}>{drawingWords(drawing)}</p>
          <Button disabled={drawing.corners.length < 3} onClick={finish}>
            Finish
          </Button>
          <Button
            variant="default"
            disabled={drawing.corners.length === 0}
            onClick={() => onDrawing({ ...drawing, corners: drawing.corners.slice(0, -1) })}
          >
            Take back the last corner
          </Button>
          <Button variant="default" onClick={() => onDrawing(null)}>
            Cancel
          </Button>
        </div>
      ) : (
        <div className={classes.actions}>
          {(["polygon", "box"] as const).map((tool) => (
            <Button
              key={tool}
              variant="default"
              disabled={!mayEdit}
              onClick={() => onDrawing({ tool, corners: [] })}
            >
              Draw {tool}
            </Button>
          ))}
        </div>
      )}
      {error && (
        <p className={classes.error} role="alert">
          {errorWords(error)}
        </p>
      )}
      {!drawing && (
        <footer className={classes.foot}>
          {isChanged ? (
            <>
              <TextInput
                className={classes.why}
                label="Why it is changed"
                required
                minLength={3}
                maxLength={300}
                value={reason}
                onChange={(event) => setReason(event.currentTarget.value)}
              />
              <Button type="submit" loading={save.isPending}>
                Save draft
              </Button>
              <Button variant="default" onClick={discard}>
                Discard
              </Button>
            </>
          ) : (
            <>
              {!zones.is_approved && (
                <Button
                  disabled={!mayApprove}
                  loading={approve.isPending}
                  onClick={() => approve.mutate(zones.version_count)}
                >
                  Approve version {zones.version_count}
                </Button>
              )}
              {zones.undo_version_count !== null && (
                <Button
                  variant="default"
                  disabled={!mayEdit}
                  loading={undo.isPending}
                  onClick={() => undo.mutate()}
                >
                  Undo the last change
                </Button>
              )}
            </>
          )}
          <p className={classes.note}>{footWords(mayEdit, approves, isOwn, isChanged, zones)}</p>
        </footer>
      )}
    </form>
  );
}

function drawingWords({ tool, corners }: Drawing): string {
  if (tool === "box")
    return corners.length ? "Click or tap the opposite corner." : "Click or tap one corner.";
  const order = "Click or tap the ground in the order in which one walks around.";
  return `${corners.length} corners. ${order}`;
}

function footWords(
  mayEdit: boolean,
  approves: boolean,
  isOwn: boolean,
  isChanged: boolean,
  zones: Zones,
) {
  if (!mayEdit) return "Your role may look. Operators may draw, supervisors approve.";
  if (isChanged) return "Not saved: nothing is kept free by it yet.";
  if (zones.is_approved) return "A zone keeps arm, gripper and loads out. It protects no people.";
  if (!approves) return "In force once a supervisor approves it.";
  if (!isOwn) return "In force once approved.";
  if (zones.is_four_eyes) return "You drew it: in force once another supervisor approves it.";
  return "You drew it yourself: look again before you approve it.";
}
