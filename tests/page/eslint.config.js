import js from "@eslint/js";
import globals from "globals";

const rules = {
  ...js.configs.recommended.rules,
  "no-unused-vars": ["error", { argsIgnorePattern: "^_" }],
  "prefer-const": "error",
  "no-var": "error",
  eqeqeq: "error",
  "no-shadow": "error",
  "no-implicit-globals": "error",
};

export default [
  { ignores: ["**/vendor/**", "**/node_modules/**"] },
  {
    files: ["rail_sumo/pictures/replay/*.js"],
    languageOptions: { ecmaVersion: 2023, sourceType: "module", globals: { ...globals.browser, uPlot: "readonly" } },
    rules,
  },
  {
    files: ["rail_sumo/pictures/report/*.js"],
    languageOptions: { ecmaVersion: 2023, sourceType: "script", globals: globals.browser },
    rules: { ...rules, "no-implicit-globals": "off" },
  },
  {
    files: ["tests/page/*.js"],
    languageOptions: { ecmaVersion: 2023, sourceType: "module", globals: { ...globals.node, ...globals.browser } },
    rules,
  },
];
