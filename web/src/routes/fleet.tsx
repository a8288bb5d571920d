import { FleetRow } from "../machine/FleetRow";
import { StopAllButton } from "../machine/StopAllButton";
import { GateSentence } from "../operate/GateSentence";
import { useLive } from "../session/liveStore";
import { zoneName } from "../words/time";
import classes from "./fleet.module.css";

/** Fleet: every machine of this site with its state, holder and link; lost ones stay. */
export function FleetPage() {
  const machines = useLive((live) => live.machines);
  const isLoaded = useLive((live) => live.isLoaded);
  const all = Object.values(machines).sort((a, b) => a.machine_id.localeCompare(b.machine_id));
  return (
    <div className={classes.page}>
      <header className={classes.head}>
        <h1>Fleet</h1>
      </header>
      {isLoaded && all.length === 0 && (
        <GateSentence sentence="No machine has connected to this server yet. Start one: downrange machine." />
      )}
      {all.length > 0 && (
        <table className={classes.table}>
          <thead>
            <tr>
              <th scope="col">Machine</th>
              <th scope="col">Site</th>
              <th scope="col">State</th>
              <th scope="col">In control</th>
              <th scope="col">Link</th>
              <th scope="col">Last seen, {zoneName(new Date())}</th>
              <th scope="col">Load</th>
              <th scope="col">Records to send</th>
              <th scope="col">Software</th>
              <th scope="col">
                <span className="visually-hidden">Open</span>
              </th>
            </tr>
          </thead>
          <tbody>
            {all.map((machine) => (
              <FleetRow key={machine.machine_id} machine={machine} />
            ))}
          </tbody>
        </table>
      )}
      {all.length > 0 && <StopAllButton />}
    </div>
  );
}
