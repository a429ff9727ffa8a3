// Light or dark: as the system is, until the reader chooses.

import { PALETTES } from "./colours.js";

const SYSTEM = "(prefers-color-scheme: dark)";

function isDark() {
  const { theme } = document.documentElement.dataset;
  return theme ? theme === "dark" : matchMedia(SYSTEM).matches;
}

export function presentPalette() {
  return isDark() ? PALETTES.dark : PALETTES.light;
}

export function switchTheme() {
  document.documentElement.dataset.theme = isDark() ? "light" : "dark";
}

/** Call `changed` when the system turns light or dark. */
export function watchTheme(changed) {
  matchMedia(SYSTEM).addEventListener("change", changed);
}
