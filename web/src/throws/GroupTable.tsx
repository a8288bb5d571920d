import { Select } from "@mantine/core";
import { GroupMark } from "../charts/GroupMark";
import { groupStyle } from "../charts/groups";
import type { Schema } from "../session/client";
import { fixed, signed } from "../words/format";
import type { GroupBy } from "./filters";
import classes from "./GroupTable.module.css";

const GROUPINGS = [
  { value: "policy", label: "By policy" },
  { value: "mode", label: "By mode" },
  { value: "machine", label: "By machine" },
  { value: "operator", label: "By person" },
];

type Props = { stats: Schema["ThrowStats"]; groupBy: GroupBy; onGroupBy: (by: GroupBy) => void };

/** Legend and numbers of the groups in the charts: n, mean, standard deviation. */
export function GroupTable({ stats, groupBy, onGroupBy }: Props) {
  return (
    <table className={classes.groups}>
      <thead>
        <tr>
          <th scope="col">
            <Select
              size="xs"
              w={118}
              aria-label="Group"
              data={GROUPINGS}
              value={groupBy}
              allowDeselect={false}
              onChange={(value) => onGroupBy(value as GroupBy)}
            />
          </th>
          <th scope="col">n</th>
          <th scope="col">Along, m: mean,&nbsp;sd</th>
          <th scope="col">Across, m: mean,&nbsp;sd</th>
        </tr>
      </thead>
      <tbody>
        {stats.groups.map((group) => (
          <tr key={group.group}>
            <th scope="row">
              <GroupMark {...groupStyle(stats.groups, group.group)} /> {group.label}
            </th>
            <td>{group.throw_count}</td>
            <td>
              {signed(group.mean_downrange_error_m)}, {fixed(group.sd_downrange_m)}
            </td>
            <td>
              {signed(group.mean_crossrange_error_m)}, {fixed(group.sd_crossrange_m)}
            </td>
          </tr>
        ))}
      </tbody>
    </table>
  );
}
