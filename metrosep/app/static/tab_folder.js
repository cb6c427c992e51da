// @ts-check

/** @param {import("./tabs.js").Context} context @returns {import("./tabs.js").Tab} */
export function make(context) {
  return {};
}
