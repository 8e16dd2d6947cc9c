// SPDX-License-Identifier: Apache-2.0
// Style sheet of the report: a column of cards, with a light and a dark theme. The
// colours of curves differ in lightness and in hue. Colour-blind readers can therefore
// distinguish the curves, also in black-and-white print. Private to the report.
#pragma once

#include <string_view>

namespace relidar::report {

inline constexpr std::string_view kReportStyle =
    R"css(
:root { color-scheme: light dark; --page: #f4f5f7; --card: #ffffff; --ink: #1b1f24; --soft: #5d6672; --line: #e1e4e8;
  --accent: #1f6feb; --best: #0a7d4b;
  --c0: #1f6feb; --c1: #d9580f; --c2: #12966b; --c3: #b0389c; --c4: #a07600; --c5: #5b4bd1; --c6: #d12f4b; --c7: #4c8fb5; }
@media (prefers-color-scheme: dark) { :root { --page: #0f1216; --card: #181c22; --ink: #e4e8ee;
  --soft: #98a2b0; --line: #2b313a;
  --accent: #5b9dff; --best: #45c98f;
  --c0: #5b9dff; --c1: #ff9152; --c2: #3ecb9a; --c3: #e07fd0; --c4: #e0b83d; --c5: #9c8cff; --c6: #ff7389; --c7: #8cc4e3; } }
* { box-sizing: border-box; }
body { margin: 0; padding: 40px 24px 32px; background: var(--page); color: var(--ink);
  font: 15px/1.55 system-ui, -apple-system, "Segoe UI", Roboto, "Helvetica Neue", Arial, sans-serif; }
main { max-width: 1180px; margin: 0 auto; }
h1 { margin: 0 0 6px; font-size: 28px; line-height: 1.2; letter-spacing: -0.01em; }
h2 { margin: 0 0 14px; font-size: 17px; }
h3 { margin: 18px 0 8px; font-size: 14px; }
.summary { max-width: 75ch; margin: 0 0 24px; color: var(--soft); }
section { margin: 0 0 20px; padding: 20px 24px 22px; background: var(--card); border: 1px solid var(--line); border-radius: 10px; }
.note { margin: 10px 0 0; color: var(--soft); font-size: 13px; }
dl { display: grid; grid-template-columns: repeat(auto-fit, minmax(240px, 1fr)); gap: 12px 28px; margin: 0; }
dt { color: var(--soft); font-size: 13px; }
dd { margin: 0; font-weight: 600; overflow-wrap: anywhere; }
.scroll { overflow-x: auto; }
table { border-collapse: collapse; min-width: 100%; font-variant-numeric: tabular-nums; }
th, td { padding: 6px 12px; border-bottom: 1px solid var(--line); text-align: right; white-space: nowrap; }
th { font-weight: 600; } thead th { border-bottom-width: 2px; vertical-align: bottom; }
th:first-child, td:first-child { text-align: left; padding-left: 4px; }
tbody tr:last-child td { border-bottom: 0; }
td.name { font-family: ui-monospace, "SF Mono", Menlo, Consolas, "Liberation Mono", monospace; font-size: 13px; }
tr.group td { padding-top: 14px; color: var(--soft); font-size: 12px; font-weight: 600; letter-spacing: 0.05em; text-transform: uppercase; }
td.best { color: var(--best); font-weight: 700; }
tr.total td { font-weight: 700; }
td.bar { width: 50%; min-width: 160px; padding-right: 0; }
td.bar div { height: 10px; min-width: 1px; border-radius: 3px; background: var(--accent); }
.charts { display: grid; grid-template-columns: repeat(auto-fit, minmax(420px, 1fr)); gap: 22px 30px; }
.charts h3 { margin-top: 0; }
svg { display: block; width: 100%; height: auto; }
svg .line { fill: none; stroke-width: 1.8; stroke-linejoin: round; } svg circle { stroke: none; }
svg .faint { stroke-width: 1; opacity: 0.28; }
svg .grid { stroke: var(--line); } svg .tick { stroke: var(--soft); } svg .axis { fill: var(--soft); font-size: 11.5px; }
.legend { display: flex; flex-wrap: wrap; gap: 4px 18px; margin: 6px 0 0 58px; padding: 0; list-style: none; font-size: 13px; }
.legend i { display: inline-block; width: 18px; height: 3px; margin-right: 7px; border-radius: 2px; vertical-align: middle; }
figure { margin: 0 0 14px; } figure:last-child { margin-bottom: 0; }
figcaption { margin: 0 0 4px; color: var(--soft); font-size: 13px; }
img { display: block; width: 100%; border-radius: 4px; image-rendering: pixelated; }
details { margin: 0 0 12px; padding: 12px 24px; background: var(--card); border: 1px solid var(--line); border-radius: 10px; }
summary { font-weight: 600; cursor: pointer; } details[open] summary { margin-bottom: 12px; }
:focus-visible { outline: 2px solid var(--accent); outline-offset: 2px; }
.pair { display: grid; grid-template-columns: repeat(auto-fit, minmax(420px, 1fr)); gap: 14px; }
.pair canvas { display: block; width: 100%; height: 400px; border-radius: 6px; touch-action: none; cursor: grab; }
.controls { display: flex; align-items: center; gap: 18px; margin: 4px 0 0; }
select { padding: 3px 6px; border: 1px solid var(--soft); border-radius: 5px; background: var(--card); color: var(--ink);
  font: inherit; }
.legend3d i { display: inline-block; width: 120px; height: 9px; margin: 0 8px; border-radius: 3px; }
td.key { white-space: normal; text-align: left; font-weight: 600; }
td.key small { display: block; color: var(--soft); font-size: 13px; font-weight: 400; }
td.stack { min-width: 240px; } td.stack div { display: inline-block; height: 14px; vertical-align: middle; }
th i { display: inline-block; width: 10px; height: 10px; margin-right: 6px; border-radius: 2px; }
.b0 { background: #2a9d8f; } .b1 { background: #8ab17d; } .b2 { background: #e9c46a; }
.b3 { background: #e76f51; } .b4 { background: #8d99ae; }
footer { color: var(--soft); font-size: 13px; text-align: center; }
.c0 { --c: var(--c0); } .c1 { --c: var(--c1); } .c2 { --c: var(--c2); } .c3 { --c: var(--c3); }
.c4 { --c: var(--c4); } .c5 { --c: var(--c5); } .c6 { --c: var(--c6); } .c7 { --c: var(--c7); }
.line { stroke: var(--c); } circle { fill: var(--c); } .legend i { background: var(--c); }
@media (max-width: 560px) { .charts { grid-template-columns: 1fr; } body { padding: 24px 12px; } section { padding: 16px; } }
@media print { body { background: none; padding: 0; } section { break-inside: avoid; border: 0; padding: 0; } }
)css";

}  // namespace relidar::report
