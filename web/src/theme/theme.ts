/** Mantine theme: one accent, square corners, large enough to touch; colours live in tokens.css. */

import {
  ActionIcon,
  Button,
  createTheme,
  Menu,
  Modal,
  NumberInput,
  Paper,
  SegmentedControl,
  Select,
  TextInput,
} from "@mantine/core";

export const theme = createTheme({
  fontFamily: '"Inter Variable", system-ui, "Segoe UI", Roboto, sans-serif',
  fontFamilyMonospace: 'ui-monospace, "Cascadia Mono", "DejaVu Sans Mono", monospace',
  colors: {
    // Blue-grey instead of Mantine's neutral greys, so that controls and surfaces are of one family.
    dark: [
      "#e9ecef",
      "#c9d0d6",
      "#a4adb7",
      "#7d8791",
      "#3a424a",
      "#2b3238",
      "#20262b",
      "#181c20",
      "#121518",
      "#0f1214",
    ],
  },
  primaryColor: "blue",
  primaryShade: { light: 8, dark: 8 },
  defaultRadius: "sm",
  fontWeights: { medium: "500" },
  cursorType: "pointer",
  focusRing: "auto",
  respectReducedMotion: true,
  components: {
    ActionIcon: ActionIcon.extend({ defaultProps: { variant: "subtle", color: "gray", size: 36 } }),
    Button: Button.extend({ defaultProps: { radius: "sm" } }),
    NumberInput: NumberInput.extend({ defaultProps: { radius: "sm" } }),
    TextInput: TextInput.extend({ defaultProps: { radius: "sm" } }),
    Select: Select.extend({ defaultProps: { radius: "sm", checkIconPosition: "right" } }),
    Paper: Paper.extend({ defaultProps: { radius: "sm", shadow: "none" } }),
    Menu: Menu.extend({ defaultProps: { radius: "sm", shadow: "md" } }),
    ModalCloseButton: Modal.CloseButton.extend({ defaultProps: { "aria-label": "Close" } }),
    // Mantine makes it a <header>: in a dialog that would be a second banner of the page.
    ModalHeader: Modal.Header.extend({ defaultProps: { role: "presentation" } }),
    SegmentedControl: SegmentedControl.extend({ defaultProps: { radius: "sm" } }),
  },
});
