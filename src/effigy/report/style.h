// The style sheet of reports.
#pragma once

namespace effigy::detail {

inline constexpr const char* kReportStyle = R"css(
:root{color-scheme:light dark;--paper:#fbfaf8;--card:#fff;--ink:#1c1b1a;--soft:#6a6762;--line:#e4e0da;
--faint:#f1eeea;--accent:#0f6f78;--s0:#1f6fd0;--s1:#d9730d;--s2:#12876a;--s3:#b8377e;--s4:#7a55c7;
--s5:#8a6d0b;--s6:#5c6670;--s7:#c03a2b}
@media(prefers-color-scheme:dark){:root{--paper:#141416;--card:#1c1c1f;--ink:#ecebe8;--soft:#9c9993;
--line:#313135;--faint:#232327;--accent:#5cc4cc;--s0:#6aa9ff;--s1:#f5a04c;--s2:#4cc9a4;--s3:#f07ab8;
--s4:#b096f5;--s5:#d8bd55;--s6:#a3adb8;--s7:#ff7b6b}}
*{box-sizing:border-box}
html{-webkit-text-size-adjust:100%;scroll-behavior:smooth}
body{margin:0;background:var(--paper);color:var(--ink);
font:16px/1.6 system-ui,-apple-system,"Segoe UI",Roboto,"Helvetica Neue",Arial,sans-serif;
font-variant-numeric:tabular-nums}
main{max-width:1080px;margin:0 auto;padding:56px 28px 80px}
header{margin-bottom:36px}
h1{font-size:clamp(1.7rem,4.5vw,2.5rem);line-height:1.15;letter-spacing:-.02em;margin:0;font-weight:650}
.subtitle{margin:10px 0 0;color:var(--soft);font-size:1.06rem;max-width:76ch;text-wrap:balance}
nav{display:flex;flex-wrap:wrap;gap:6px 20px;margin-top:22px;padding-top:14px;
border-top:1px solid var(--line);font-size:.92rem}
a{color:var(--accent);text-decoration:none}
a:hover{text-decoration:underline}
h2{font-size:1.38rem;letter-spacing:-.01em;line-height:1.25;margin:58px 0 14px;font-weight:640;
scroll-margin-top:16px}
h3{font-size:1.04rem;margin:34px 0 10px;font-weight:620}
p{margin:0 0 16px;max-width:72ch;text-wrap:pretty;white-space:pre-line}
.note{border-left:3px solid var(--accent);background:var(--faint);padding:12px 18px;
border-radius:0 8px 8px 0;margin:20px 0;max-width:none}
pre{background:var(--faint);border:1px solid var(--line);border-radius:8px;padding:12px 16px;
overflow-x:auto;font:.87rem/1.55 ui-monospace,SFMono-Regular,Menlo,Consolas,monospace;margin:0 0 20px}
.tiles{display:grid;grid-template-columns:repeat(auto-fill,minmax(max(140px,calc((100% - 12px*(var(--n) - 1))/var(--n))),1fr));gap:12px;margin:22px 0 26px}
.tile{background:var(--card);border:1px solid var(--line);border-radius:12px;padding:14px 18px 13px}
.tile .name{color:var(--soft);font-size:.86rem}
.tile .value{font-size:1.75rem;line-height:1.3;font-weight:620;letter-spacing:-.015em;white-space:nowrap}
.tile .unit{font-size:.95rem;font-weight:450;color:var(--soft);margin-left:.25em;letter-spacing:0}
.tile .hint{color:var(--soft);font-size:.8rem;line-height:1.4}
.scroll{overflow-x:auto;margin:0 0 24px}
table{border-collapse:collapse;min-width:50%;font-size:.94rem}
caption{text-align:left;color:var(--soft);font-size:.88rem;padding:0 0 8px}
th{text-align:left;font-weight:560;color:var(--soft);font-size:.86rem;border-bottom:1px solid var(--ink);
vertical-align:bottom}
th,td{padding:8px 22px 8px 0}
td.num{white-space:nowrap}
td:first-child{min-width:12ch}
td{border-bottom:1px solid var(--line)}
th:last-child,td:last-child{padding-right:4px}
.num{text-align:right}
tbody tr:hover{background:var(--faint)}
dl{display:grid;grid-template-columns:repeat(auto-fill,minmax(min(100%,330px),1fr));gap:0 40px;margin:0 0 24px}
dl div{display:flex;justify-content:space-between;gap:20px;border-bottom:1px solid var(--line);padding:7px 0}
dt{color:var(--soft);white-space:nowrap}
dd{margin:0;text-align:right;overflow-wrap:anywhere}
figure{margin:0 0 28px}
figcaption{color:var(--soft);font-size:.9rem;margin-top:8px;max-width:72ch}
.zoom{display:block;cursor:zoom-in}
.zoom input{position:absolute;opacity:0;width:1px;height:1px}
.zoom img{display:block;width:100%;height:auto;border-radius:6px;background:var(--faint)}
.zoom.small img{image-rendering:pixelated}
.zoom input:focus-visible+img{outline:3px solid var(--accent);outline-offset:2px}
.zoom input:checked+img{position:fixed;z-index:9;inset:0;width:100vw;height:100vh;object-fit:contain;
border-radius:0;background:rgba(10,10,12,.94);cursor:zoom-out;max-width:none}
.grid{display:grid;gap:8px;align-items:start;overflow-x:auto;margin:0 0 28px;padding-bottom:4px}
.grid .col{color:var(--soft);font-size:.86rem;line-height:1.35;align-self:end}
.grid .row{color:var(--soft);font-size:.86rem;line-height:1.35;align-self:center;overflow-wrap:anywhere;
padding-right:8px;white-space:pre-line}
.plot{margin:0 0 30px}
.plot h4,.bars h4{margin:0 0 4px;font-size:.98rem;font-weight:600}
.legend{display:flex;flex-wrap:wrap;gap:2px 18px;font-size:.86rem;color:var(--soft);margin-bottom:6px}
.legend i{display:inline-block;width:16px;height:3px;border-radius:2px;margin-right:7px;vertical-align:.22em}
.plot svg{display:block;width:100%;min-width:430px;height:auto;overflow:visible}
.plot text{fill:var(--soft);font-size:12px;font-family:inherit}
.plot .rule{stroke:var(--line)}
.plot .axis{stroke:var(--soft)}
.plot path{fill:none;stroke-width:1.8;stroke-linejoin:round;stroke-linecap:round}
.bars{margin:0 0 30px}
.bar{display:grid;grid-template-columns:minmax(90px,190px) 1fr minmax(64px,auto);gap:14px;align-items:center;
font-size:.92rem;padding:3px 0}
.bar .track{background:var(--faint);border-radius:4px;height:13px}
.bar .fill{background:var(--s0);border-radius:4px;height:13px;min-width:2px}
.bar .label{text-align:right}
footer{margin-top:64px;padding-top:16px;border-top:1px solid var(--line);color:var(--soft);font-size:.85rem}
@media(max-width:640px){main{padding:30px 16px 56px}h2{margin-top:42px}
.tiles{grid-template-columns:repeat(2,1fr);gap:8px}.tile{padding:11px 13px}.tile .value{font-size:1.4rem}
th,td{padding-right:18px}
.grid.named{grid-template-columns:repeat(var(--n),minmax(var(--least),1fr))!important}
.grid .row{grid-column:1/-1;padding-top:6px;white-space:normal;position:sticky;left:0;justify-self:start}
.grid .corner{display:none}.plot text{font-size:21px}
.bar{grid-template-columns:minmax(70px,110px) 1fr auto;gap:10px}}
@media print{body{background:#fff}.grid,.scroll{overflow:visible}h2{break-after:avoid}figure,.plot,.tile{break-inside:avoid}}
)css";

}  // namespace effigy::detail
