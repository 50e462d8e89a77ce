// One switch for all code of a page, off at first where the screen is narrow, but not in exercises,
// where code is part of the task; and all folds open on paper, but for code.
"use strict";
(() => {
  const remembered = () => {
    try { return localStorage.getItem("statebook-code"); } catch { return null; }
  };
  const remember = (value) => {
    try { localStorage.setItem("statebook-code", value); } catch { /* a private window */ }
  };

  const addSwitch = () => {
    const title = document.querySelector("article h1");
    if (!title || !document.querySelector(".cell_input")) return;
    const button = document.createElement("button");
    button.type = "button";
    button.className = "sb-code-switch";
    const show = (on) => {
      document.body.classList.toggle("sb-no-code", !on);
      button.textContent = on ? "Hide code" : "Show code";
      button.setAttribute("aria-pressed", String(on));
    };
    const narrow = window.matchMedia("(max-width: 40em)").matches;
    const task = location.pathname.includes("/exercises/");
    let on = task || (remembered() || (narrow ? "off" : "on")) === "on";
    show(on);
    button.addEventListener("click", () => {
      on = !on;
      show(on);
      remember(on ? "on" : "off");
    });
    title.after(button);
  };

  const opened = [];
  window.addEventListener("beforeprint", () => {
    for (const fold of document.querySelectorAll("article details:not(.hide):not([open])")) {
      fold.open = true;
      opened.push(fold);
    }
  });
  window.addEventListener("afterprint", () => {
    for (const fold of opened.splice(0)) fold.open = false;
  });

  document.addEventListener("DOMContentLoaded", addSwitch);
})();
