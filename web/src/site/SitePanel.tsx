import { Button } from "@mantine/core";
import { IconBox, IconMountain, IconShovel, IconTrash } from "@tabler/icons-react";
import { useState } from "react";
import type { Schema } from "../session/client";
import type { Machine } from "../session/live";
import { useMay } from "../session/useSession";
import { errorWords } from "../words/errors";
import { zonedStamp } from "../words/time";
import { ObjectForm } from "./ObjectForm";
import { isSameSite, KINDS, type Kind, newObject, placeWords, type SiteObject } from "./objects";
import classes from "./SitePanel.module.css";
import { useSiteActions } from "./useSite";

const ICONS: Record<Kind, typeof IconBox> = { box: IconBox, pit: IconShovel, pile: IconMountain };

type Props = { machine: Machine; site: Schema["SiteView"] };

/** The objects around a machine, their fields, and what was typed but not saved yet. */
export function SitePanel({ machine, site }: Props) {
  const [draft, setDraft] = useState<SiteObject[] | null>(null);
  // The version that the draft was begun with: a change by somebody else must be seen first.
  const [from, setFrom] = useState(site.version_count);
  const [open, setOpen] = useState<number | null>(null);
  const { save, undo } = useSiteActions(machine.machine_id);
  const mayEdit = useMay("site.edit");
  const objects = draft ?? site.objects;
  const isChanged = draft !== null && !isSameSite(draft, site.objects);
  const change = (next: SiteObject[]) => {
    if (draft === null) setFrom(site.version_count);
    setDraft(next);
  };
  const discard = () => {
    setDraft(null);
    save.reset();
    undo.reset();
  };
  const add = (kind: Kind) => {
    change([...objects, newObject(kind, objects, machine.target)]);
    setOpen(objects.length);
  };
  const remove = (index: number) => {
    change(objects.filter((_, other) => other !== index));
    setOpen(null);
  };
  const submit = (event: React.FormEvent) => {
    event.preventDefault();
    if (draft)
      save.mutate({ objects: draft, from_version_count: from }, { onSuccess: () => discard() });
  };
  const error = save.error ?? undo.error;
  return (
    <form className={classes.panel} onSubmit={submit} aria-label="Objects of the site">
      <header className={classes.head}>
        <h2>Around {machine.machine_id}</h2>
        <p className={classes.note}>
          {site.version_count === 0
            ? "Nobody has described this site yet."
            : `Version ${site.version_count} by ${site.changed_by}, ${zonedStamp(site.changed_utc)}`}
        </p>
      </header>
      {objects.length === 0 ? (
        <p className={classes.empty}>
          Flat ground, as far as anybody said. Add what loads are thrown at or must not hit: a truck
          bed or a wall as a box, a pit, a pile.
        </p>
      ) : (
        <ul className={classes.list}>
          {objects.map((item, index) => (
            <ObjectRow
              // biome-ignore lint/suspicious/noArrayIndexKey: names change while they are typed
              key={index}
              item={item}
              isOpen={open === index}
              mayEdit={mayEdit}
              onToggle={() => setOpen(open === index ? null : index)}
              onChange={(next) => change(objects.map((o, i) => (i === index ? next : o)))}
              onRemove={() => remove(index)}
            />
          ))}
        </ul>
      )}
      <div className={classes.actions}>
        {KINDS.map((kind) => (
          <Button key={kind} variant="default" disabled={!mayEdit} onClick={() => add(kind)}>
            Add {kind}
          </Button>
        ))}
      </div>
      {error && (
        <p className={classes.error} role="alert">
          {errorWords(error)}
        </p>
      )}
      <footer className={classes.foot}>
        {isChanged ? (
          <>
            <Button type="submit" loading={save.isPending}>
              Save
            </Button>
            <Button variant="default" onClick={discard}>
              Discard
            </Button>
          </>
        ) : (
          site.undo_version_count !== null && (
            <Button
              variant="default"
              disabled={!mayEdit}
              loading={undo.isPending}
              onClick={() => undo.mutate()}
            >
              Undo the last change
            </Button>
          )
        )}
        <p className={classes.note}>{footWords(mayEdit, isChanged)}</p>
      </footer>
    </form>
  );
}

function footWords(mayEdit: boolean, isChanged: boolean): string {
  if (!mayEdit) return "Your role may look. Operators may change it.";
  return isChanged
    ? "Not saved: previews do not know it yet."
    : "Previews and the 3D view use it at once. Nothing measures the site: keep it true.";
}

type RowProps = {
  item: SiteObject;
  isOpen: boolean;
  mayEdit: boolean;
  onToggle: () => void;
  onChange: (item: SiteObject) => void;
  onRemove: () => void;
};

function ObjectRow({ item, isOpen, mayEdit, onToggle, onChange, onRemove }: RowProps) {
  const Icon = ICONS[item.kind];
  return (
    <li className={classes.object}>
      <div className={classes.line}>
        <button type="button" className={classes.name} aria-expanded={isOpen} onClick={onToggle}>
          <Icon size={20} stroke={1.7} aria-label={item.kind} />
          <span className={classes.title}>{item.name}</span>
          <span className={classes.place}>{placeWords(item)}</span>
        </button>
        <Button
          variant="subtle"
          color="gray"
          disabled={!mayEdit}
          aria-label={`Delete ${item.name}`}
          onClick={onRemove}
        >
          <IconTrash size={18} aria-hidden />
        </Button>
      </div>
      {isOpen && <ObjectForm item={item} isDisabled={!mayEdit} onChange={onChange} />}
    </li>
  );
}
