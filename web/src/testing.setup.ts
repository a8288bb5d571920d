/** Before every test file with components: a busy computer takes longer than a second, and is not wrong. */

import { configure } from "@testing-library/react";

configure({ asyncUtilTimeout: 20_000 });
