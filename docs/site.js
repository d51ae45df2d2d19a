// What the theme leaves to people who read with the keyboard or a screen reader.
function mend() {
  // A table's empty corner heads nothing.
  for (const corner of document.querySelectorAll("th:empty")) corner.replaceWith(document.createElement("td"));
  // A table that is wider than the page is moved with the arrow keys.
  for (const table of document.querySelectorAll(".md-typeset__scrollwrap:not([tabindex])")) table.tabIndex = 0;
  // The button that copies a block of code is no part of the navigation.
  for (const buttons of document.querySelectorAll("nav.md-code__nav:not([role])")) buttons.setAttribute("role", "none");
}

new MutationObserver(mend).observe(document.body, { childList: true, subtree: true });
mend();
