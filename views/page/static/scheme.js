// Dark, light, or as the system has it: chosen before the page is drawn, so that the page does not flash.
{
  const KEY = "canskin.scheme";
  const NEXT = { auto: "dark", dark: "light", light: "auto" };
  const root = document.documentElement;
  const choose = (scheme) => {
    root.dataset.scheme = scheme;
    const button = document.getElementById("scheme");
    if (!button) return;
    button.textContent = { auto: "◐ auto", dark: "● dark", light: "○ light" }[scheme];
    button.ariaLabel = `Colours: ${scheme}; choose ${NEXT[scheme]}`;
  };
  const change = () => {
    const scheme = NEXT[root.dataset.scheme];
    localStorage.setItem(KEY, scheme);
    choose(scheme);
    dispatchEvent(new Event("schemechange"));
  };
  const kept = localStorage.getItem(KEY);
  choose(kept in NEXT ? kept : "auto");
  document.addEventListener("DOMContentLoaded", () => {
    choose(root.dataset.scheme);
    document.getElementById("scheme").onclick = change;
  });
  matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => dispatchEvent(new Event("schemechange")));
}
