import { Button } from "@mantine/core";
import { useNavigate } from "@tanstack/react-router";
import type { Machine } from "../session/live";
import { useNow } from "../session/useNow";
import { age } from "../words/format";
import { ageSeconds, localStamp } from "../words/time";
import { Lamp } from "./Lamp";
import { linkQuality } from "./phase";
import { useMachineId } from "./useMachine";

/** One machine of the fleet. */
export function FleetRow({ machine }: { machine: Machine }) {
  const [, choose] = useMachineId();
  const navigate = useNavigate();
  const seen = machine.link.last_seen_utc;
  const seen_s = ageSeconds(seen, useNow());
  const open = () => {
    choose(machine.machine_id);
    void navigate({ to: "/operate" });
  };
  return (
    <tr>
      <th scope="row">{machine.name || machine.machine_id}</th>
      <td>{machine.site}</td>
      <td>
        <Lamp machine={machine} />
      </td>
      <td>{machine.lease.holder ?? "nobody"}</td>
      <td>{linkQuality(machine).words}</td>
      <td title={localStamp(seen)}>{seenWords(seen_s)}</td>
      <td>{machine.state ? (machine.state.payload_held ? "held" : "empty") : "–"}</td>
      <td>{machine.state?.outbox_count ?? "–"}</td>
      <td>{machine.state?.software || "–"}</td>
      <td>
        <Button variant="default" size="sm" onClick={open}>
          Operate
        </Button>
      </td>
    </tr>
  );
}

function seenWords(seen_s: number | null): string {
  if (seen_s === null) return "never";
  return seen_s < 2 ? "now" : `${age(seen_s)} ago`;
}
