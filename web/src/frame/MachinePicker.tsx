import { Select } from "@mantine/core";
import { phaseWord } from "../machine/phase";
import { useMachineId } from "../machine/useMachine";
import { useLive } from "../session/liveStore";

/** Machines by site; lost ones stay in the list with their state. */
export function MachinePicker() {
  const machines = useLive((live) => live.machines);
  const [id, choose] = useMachineId();
  const sites = [...new Set(Object.values(machines).map((machine) => machine.site))].sort();
  const data = sites.map((site) => ({
    group: site,
    items: Object.values(machines)
      .filter((machine) => machine.site === site)
      .sort((a, b) => a.machine_id.localeCompare(b.machine_id))
      .map((machine) => ({ value: machine.machine_id, label: machineLabel(machine) })),
  }));
  return (
    <Select
      aria-label="Site and machine"
      data={data}
      value={id}
      onChange={(value) => value && choose(value)}
      placeholder="No machine yet"
      allowDeselect={false}
      w={168}
      comboboxProps={{ width: 260, position: "bottom-start" }}
      renderOption={({ option }) => {
        const machine = machines[option.value];
        return `${option.label}${machine ? `: ${phaseWord(machine.lamp).toLowerCase()}` : ""}`;
      }}
    />
  );
}

function machineLabel(machine: { machine_id: string; site: string; name: string }): string {
  return `${machine.site} / ${machine.name || machine.machine_id}`;
}
