"""The style sheet of every report page: one column, light and dark by the reader's system, and print."""

STYLESHEET = """
:root {
  color-scheme: light dark;
  --page: #ffffff; --raised: #f5f6f8; --ink: #1b2430; --muted: #5c6775; --line: #e1e5ea; --band: #eceff3;
  --measured: #a3adba; --predicted: #1668b8; --residual: #c2410c;
  --data: #1668b8; --combined: #1668b8; --bound: #c2410c; --prior: #7a8594; --fixed: #a3adba;
  --good: #15803d; --fair: #a16207; --poor: #b91c1c; --unknown: #5c6775; --caution: #fdf3e0; --bar: #cfe2f5;
  --before: #d9762b; --after: #1668b8; --found: #1668b8;
}
@media screen and (prefers-color-scheme: dark) {
  :root {
    --page: #14181e; --raised: #1c222b; --ink: #e6eaf0; --muted: #98a3b2; --line: #2b333f; --band: #222933;
    --measured: #6d7889; --predicted: #6cb2f5; --residual: #fb8d52;
    --data: #6cb2f5; --combined: #6cb2f5; --bound: #fb8d52; --prior: #8e99a8; --fixed: #6d7889;
    --good: #4ade80; --fair: #facc15; --poor: #f87171; --unknown: #98a3b2; --caution: #33291a; --bar: #233f5c;
    --before: #f0a060; --after: #6cb2f5; --found: #6cb2f5;
  }
}
* { box-sizing: border-box; }
body { margin: 0; background: var(--page); color: var(--ink); line-height: 1.5;
  font: 15px/1.5 system-ui, -apple-system, "Segoe UI", Roboto, "Noto Sans", "DejaVu Sans", sans-serif; }
main { max-width: 1060px; margin: 0 auto; padding: 32px 24px 64px; }
h1 { font-size: 26px; line-height: 1.2; margin: 0; overflow-wrap: anywhere; }
h2 { font-size: 19px; margin: 44px 0 8px; padding-top: 12px; border-top: 1px solid var(--line); }
h3 { font-size: 15px; margin: 20px 0 2px; overflow-wrap: anywhere; }
h3 small { font-weight: 400; color: var(--muted); margin-left: 8px; }
p { margin: 6px 0; max-width: 84ch; } p.quiet { max-width: 100ch; }
.quiet, figcaption { font-weight: 400; color: var(--muted); font-size: 13.5px; }
.verdict { margin: 20px 0 0; padding: 16px 20px; background: var(--raised); border-left: 5px solid var(--unknown);
  border-radius: 4px; }
.verdict h2 { margin: 0 0 4px; padding: 0; border: 0; font-size: 18px; }
.verdict.good { border-color: var(--good); } .verdict.fair { border-color: var(--fair); }
.verdict.poor, .verdict.suspect { border-color: var(--poor); } .verdict.found { border-color: var(--found); }
.card { margin: 16px 0; padding: 4px 20px 14px; border: 1px solid var(--line); border-radius: 6px; }
.card h3 { font-size: 16.5px; margin-top: 12px; }
.card table.narrow { width: auto; }
.meter { display: inline-block; width: 140px; height: 9px; margin-right: 10px; border-radius: 2px;
  background: var(--band); vertical-align: middle; }
.meter > span { display: block; height: 100%; border-radius: 2px; background: var(--after); }
dd small { color: var(--muted); font-size: 13px; }
ul.warnings { list-style: none; margin: 12px 0 0; padding: 0; }
ul.warnings li { margin: 6px 0; padding: 8px 14px; background: var(--caution); border-radius: 4px; }
ul.warnings li::before { content: "! "; font-weight: 700; color: var(--fair); }
figure { margin: 8px 0; break-inside: avoid; }
section.joint { break-inside: avoid; }
svg { display: block; width: 100%; height: auto; }
svg * { stroke-linejoin: round; stroke-linecap: butt; }
svg text { font-family: inherit; }
.wide { overflow-x: auto; }
table { border-collapse: collapse; font-size: 13.5px; font-variant-numeric: tabular-nums; width: 100%; margin: 8px 0; }
th, td { padding: 3px 10px; text-align: right; white-space: nowrap; border-bottom: 1px solid var(--line); }
th { font-weight: 600; } thead th { color: var(--muted); font-weight: 500; vertical-align: bottom; }
th.text, td.text { text-align: left; } td.wrap, th.wrap { white-space: normal; overflow-wrap: anywhere; }
tbody th.wrap { min-width: 15ch; } td.wrap { min-width: 9ch; } thead th.wrap { overflow-wrap: normal; }
tbody.group { border-top: 1.5px solid var(--line); break-inside: avoid; }
tbody.group th { vertical-align: top; min-width: 11ch; max-width: 200px; white-space: normal;
  overflow-wrap: break-word; }
td[rowspan] { vertical-align: top; }
tr.minor td { color: var(--muted); }
td.share { background: linear-gradient(to right, var(--bar) var(--part), transparent var(--part)); min-width: 110px; }
table.matrix th, table.matrix td { padding: 2px 4px; font-size: 12px; } table.matrix .quiet { font-size: 11px; }
table.dense th, table.dense td { padding: 2px 1px; font-size: 10.5px; } table.dense .quiet { font-size: 9.5px; }
table.matrix thead th { white-space: normal; overflow-wrap: anywhere; max-width: 130px; }
.mark { display: inline-block; width: 1.1em; text-align: center; }
.data, .combined { color: var(--data); } .bound { color: var(--bound); } .prior, .fixed { color: var(--prior); }
td.rested { color: var(--muted); }
.key { display: flex; flex-wrap: wrap; gap: 4px 20px; font-size: 13.5px; color: var(--muted); margin: 6px 0; }
.swatch { display: inline-block; width: 22px; height: 0; border-top: 3px solid; margin-right: 6px;
  vertical-align: middle; }
.swatch.block { height: 11px; border: 0; background: var(--band); }
td.good { color: var(--good); } td.fair { color: var(--fair); } td.poor, td.suspect { color: var(--poor); }
tr.moved td { font-weight: 600; } a { color: var(--predicted); }
td.note { min-width: 30ch; } table.list th, table.list td { padding: 3px 6px; font-size: 12.5px; }
svg.interval { width: 96px; height: 12px; display: inline-block; vertical-align: middle; }
dl { display: grid; grid-template-columns: max-content 1fr; gap: 4px 20px; margin: 8px 0; font-size: 14px; }
dt { color: var(--muted); } dd { margin: 0; overflow-wrap: anywhere; }
code { font: 12.5px ui-monospace, "DejaVu Sans Mono", monospace; overflow-wrap: anywhere; }
summary { cursor: pointer; color: var(--predicted); margin: 10px 0 4px; }
@media screen and (max-width: 700px) {
  main { padding: 20px 16px 40px; }
  /* Figures are drawn for a column of 1000 px: here they keep a readable size and scroll in their frame. */
  figure, section.joint { overflow-x: auto; }
  figure > svg, section.joint > svg { min-width: 680px; }
  figcaption { position: sticky; left: 0; }
  dl { display: block; } dd { margin-bottom: 8px; }
  td.wrap { min-width: 20ch; }
}
@media print {
  body { font-size: 11px; }
  main { max-width: none; padding: 0; }
  h2, h3, .key { break-after: avoid; } tr { break-inside: avoid; }
  table, .key, figcaption, .quiet { font-size: 9.5px; }
  table.matrix th, table.matrix td { font-size: 8.5px; padding: 1px 4px; }
  th, td { padding: 1px 6px; } code { font-size: 8.5px; } dl { font-size: 10px; }
  td.share, .meter, .meter > span, .verdict, ul.warnings li, .swatch.block {
    print-color-adjust: exact; -webkit-print-color-adjust: exact; }
  .wide { overflow: visible; }
  details::details-content { content-visibility: visible; block-size: auto; }
}
@page { margin: 15mm 14mm; }
"""
