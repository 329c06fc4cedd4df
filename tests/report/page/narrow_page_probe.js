// SPDX-License-Identifier: MIT
import { page } from "page/state.js";

(async () => {
  while (!document.documentElement.dataset.ready) await new Promise(done => setTimeout(done, 20));
  const { across, down } = page.view.pane(), { scrollWidth } = document.scrollingElement;
  const scrolled = element => element.closest(".wide, .strip, .ticks");
  const beyond = [...document.querySelectorAll("body *")]
    .filter(element => element.getBoundingClientRect().right > innerWidth + 0.5 && !scrolled(element))
    .map(element => `${element.tagName} ${element.id} ${element.className}`);
  console.log("RESULT " + JSON.stringify({ width: scrollWidth, beyond, panes: [across, down] }));
})();
