// dom: what every part of the page needs of the document. A node that has not changed is not touched: screen readers and
// open lists would notice.

export const $ = (id) => document.getElementById(id);

export function setText(id, text) {
  if ($(id).textContent !== text) $(id).textContent = text;
}

/** Makes `choices`, [value, text], the options of a list, and chooses one. */
export function setOptions(select, choices, value) {
  const same = select.options.length === choices.length && choices.every(([v, text], i) => select.options[i].value === v && select.options[i].text === text);
  if (!same) select.replaceChildren(...choices.map(([v, text]) => new Option(text, v)));
  if (select.value !== value) select.value = value;
}
