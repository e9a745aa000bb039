"use strict";
// Sorts and filters the rows. A click on a column's head sorts by it, another turns the order; what is not known stays
// last. What is chosen is kept in the page's address, so that going back from a report finds it again.
const $ = (id) => document.getElementById(id);
const body = document.querySelector("tbody"), heads = [...document.querySelectorAll("th[data-kind]")], rows = [...body.rows];
const chosen = { verdict: "", words: "", column: 0, down: false };

function sort(column, down) {
  const head = heads[column], at = head.cellIndex, sign = down ? -1 : 1, numeric = head.dataset.kind === "number";
  Object.assign(chosen, { column, down });
  heads.forEach((other) => other.removeAttribute("aria-sort"));
  head.setAttribute("aria-sort", down ? "descending" : "ascending");
  $("order").value = `${column} ${down ? 1 : 0}`;
  const value = (row) => row.cells[at].dataset.value;
  const order = (a, b) => {
    if (value(a) === "" || value(b) === "") return (value(a) === "") - (value(b) === "");
    return sign * (numeric ? value(a) - value(b) : value(a).localeCompare(value(b), undefined, { numeric: true }));
  };
  body.append(...rows.sort(order));
}

function filter() {
  const words = chosen.words.toLowerCase().split(/\s+/);
  let left = 0;
  for (const row of rows) {
    const text = row.textContent.toLowerCase(), has = !chosen.verdict || row.dataset.verdicts.split(" ").includes(chosen.verdict);
    row.hidden = !(has && words.every((word) => text.includes(word)));
    left += !row.hidden;
  }
  for (const button of $("verdicts").children) button.setAttribute("aria-pressed", String(button.dataset.verdict === chosen.verdict));
  $("none").hidden = left > 0;
  $("count").textContent = left < rows.length ? `${left} of ${rows.length}` : "";
}

function keep() {
  history.replaceState(null, "", `#${new URLSearchParams(Object.entries(chosen).map(([k, v]) => [k, String(v)]))}`);
}

heads.forEach((head, column) => head.querySelector("button").addEventListener("click", () => {
  sort(column, chosen.column === column && !chosen.down);
  keep();
}));
$("order").addEventListener("change", () => { const [column, down] = $("order").value.split(" "); sort(Number(column), down === "1"); keep(); });
$("words").addEventListener("input", () => { chosen.words = $("words").value; filter(); keep(); });
for (const button of $("verdicts").children) button.addEventListener("click", () => { chosen.verdict = button.dataset.verdict; filter(); keep(); });

const before = new URLSearchParams(location.hash.slice(1)), column = Number(before.get("column"));
chosen.verdict = [...$("verdicts").children].some((b) => b.dataset.verdict === before.get("verdict")) ? before.get("verdict") : "";
$("words").value = chosen.words = before.get("words") || "";
sort(heads[column] ? column : 0, before.get("down") === "true");
filter();
