// SPDX-License-Identifier: Apache-2.0
// Accessibility of elements that the theme makes when a page is loaded: what can be scrolled sideways can be reached by
// the keyboard, and the buttons of code are not a landmark.

const scrollable = new ResizeObserver((entries) => {
  for (const { target } of entries) {
    target.tabIndex = target.scrollWidth > target.clientWidth ? 0 : -1;
  }
});

function improve() {
  document.querySelectorAll(".md-typeset__scrollwrap, .formula, .diagram").forEach((box) => scrollable.observe(box));
  document.querySelectorAll(".md-code__nav").forEach((buttons) => buttons.setAttribute("role", "none"));
}

improve();
new MutationObserver(improve).observe(document.body, { childList: true, subtree: true });
