// Dark, light, or as the system has it: chosen before the page is drawn, so that the page does not flash.
{
  const KEY = "canskin.scheme";
  const NEXT = { auto: "dark", dark: "light", light: "auto" };
  const root = document.documentElement;
  const keep = (use) => {
    try {
      return use(localStorage);
    } catch {
      return null; // the browser keeps nothing
    }
  };
  const choose = (scheme) => {
    root.dataset.scheme = scheme;
    const button = document.getElementById("scheme");
    if (!button) return;
    button.textContent = { auto: "◐ auto", dark: "● dark", light: "○ light" }[scheme];
    button.ariaLabel = `Colours: ${scheme}; choose ${NEXT[scheme]}`;
  };
  const change = () => {
    const scheme = NEXT[root.dataset.scheme];
    keep((storage) => storage.setItem(KEY, scheme));
    choose(scheme);
    dispatchEvent(new Event("schemechange"));
  };
  const kept = keep((storage) => storage.getItem(KEY));
  choose(kept in NEXT ? kept : "auto");
  document.addEventListener("DOMContentLoaded", () => {
    choose(root.dataset.scheme);
    document.getElementById("scheme").onclick = change;
  });
  matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => dispatchEvent(new Event("schemechange")));
}
