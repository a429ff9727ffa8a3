// The canvas's colours, light and dark. Speeds go by viridis, which every eye can order; the host has a colour apart.

const VIRIDIS = ["#440154", "#482878", "#3e4989", "#31688e", "#26828e", "#1f9e89", "#35b779", "#6ece58", "#b5de2b", "#fde725"];

export const N_SHADES = 32;

export const PALETTES = {
  light: {
    ground: "#f4f5f2",
    asphalt: "#c6cbcf",
    inside: "#c6cbcf",
    closed: "#d8d3c3",
    marking: "#ffffff",
    border: "#858f96",
    outline: "#20282d",
    host: "#d55e00",
    halo: "#ffffff",
    ink: "#1d2529",
    paper: "#ffffffd9",
    ray: "#d55e00",
    rail: "#66727a",
    chosen: "#0b57d0",
  },
  dark: {
    ground: "#14181b",
    asphalt: "#343b41",
    inside: "#343b41",
    closed: "#3f3a2f",
    marking: "#c9d0d5",
    border: "#76828a",
    outline: "#e6eaec",
    host: "#ff8a33",
    halo: "#14181b",
    ink: "#e8ecee",
    paper: "#14181bd9",
    ray: "#ff8a33",
    rail: "#93a0a8",
    chosen: "#8ab4f8",
  },
};

export const SIGNALS = { go: "#009e73", wait: "#e6a700", stop: "#d3203a", off: "#8a949b" };

/** What a letter of SUMO's says: go, wait, stop, or off. */
export function signalMeaning(letter) {
  if (letter === "G" || letter === "g") return "go";
  if (letter === "y" || letter === "Y" || letter === "u") return "wait";
  if (letter === "r" || letter === "s") return "stop";
  return "off";
}

function channels(hex) {
  return [1, 3, 5].map((at) => parseInt(hex.slice(at, at + 2), 16));
}

function viridis(share) {
  const at = Math.min(Math.max(share, 0), 1) * (VIRIDIS.length - 1);
  const [low, high] = [Math.floor(at), Math.ceil(at)];
  const [from, to] = [channels(VIRIDIS[low]), channels(VIRIDIS[high])];
  const mixed = from.map((value, k) => Math.round(value + (to[k] - value) * (at - low)));
  return `rgb(${mixed.join(" ")})`;
}

export const SHADES = Array.from({ length: N_SHADES }, (_, shade) => viridis(0.06 + (0.94 * shade) / (N_SHADES - 1)));

/** Which of the shades a speed has. */
export function shadeOf(speedMps, topMps) {
  return Math.min(Math.max(Math.round((speedMps / topMps) * (N_SHADES - 1)), 0), N_SHADES - 1);
}
