import {
  Menu,
  NativeSelect,
  SegmentedControl,
  Text,
  UnstyledButton,
  useMantineColorScheme,
} from "@mantine/core";
import { IconChevronDown, IconLogout } from "@tabler/icons-react";
import { useMutation, useQueryClient } from "@tanstack/react-query";
import { api, take } from "../session/client";
import { ME } from "../session/queries";
import { useSession } from "../session/useSession";
import { chooseZone, useZone, zoneNames } from "../words/zone";
import classes from "./TopBar.module.css";

const SCHEMES = [
  { value: "light", label: "Light" },
  { value: "dark", label: "Dark" },
  { value: "auto", label: "Auto" },
];

/** Who is signed in; theme, time zone and sign-out. */
export function PersonMenu() {
  const session = useSession();
  const client = useQueryClient();
  const { colorScheme, setColorScheme } = useMantineColorScheme();
  const logout = useMutation({
    mutationFn: () => take(api.POST("/api/v1/auth/logout")),
    onSettled: () => client.setQueryData(ME, null),
  });
  if (!session) return null;
  return (
    <Menu position="bottom-end" width={240}>
      <Menu.Target>
        <UnstyledButton className={classes.person}>
          <span>
            <span className="visually-hidden">Signed in as </span>
            <span className={classes.name}>{session.username}</span>
            <span className={classes.role}>{session.role}</span>
          </span>
          <IconChevronDown size={14} aria-hidden />
        </UnstyledButton>
      </Menu.Target>
      <Menu.Dropdown>
        <Text size="xs" c="dimmed" px="sm" pt={6} pb={4} id="theme-label">
          Theme
        </Text>
        <SegmentedControl
          aria-labelledby="theme-label"
          data={SCHEMES}
          value={colorScheme}
          onChange={(value) => setColorScheme(value as "light" | "dark" | "auto")}
          fullWidth
          mx={6}
          mb={6}
        />
        <ZoneChoice />
        <Menu.Divider />
        <Menu.Item
          leftSection={<IconLogout size={16} aria-hidden />}
          onClick={() => logout.mutate()}
        >
          Sign out
        </Menu.Item>
      </Menu.Dropdown>
    </Menu>
  );
}

/** Times in the zone of this computer, in UTC, or in that of the site. */
function ZoneChoice() {
  const zone = useZone();
  return (
    <NativeSelect
      size="xs"
      mx={6}
      mb={6}
      label="Times in"
      value={zone}
      onChange={(event) => chooseZone(event.currentTarget.value)}
      data={[{ value: "", label: "this computer's time" }, ...zoneNames()]}
    />
  );
}
