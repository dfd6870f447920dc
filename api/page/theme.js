// Before anything is drawn: the theme of last time. Without one the system's is followed.
(() => {
  const words = ["auto", "light", "dark"];
  const kept = () => {
    const word = localStorage.getItem("furrow-theme");
    return words.includes(word) ? word : "auto";
  };
  const apply = (word) => {
    if (word === "auto") delete document.documentElement.dataset.theme;
    else document.documentElement.dataset.theme = word;
    const button = document.getElementById("theme");
    if (button) button.textContent = `Theme: ${word}`;
    document.dispatchEvent(new Event("themechange"));
  };
  apply(kept());
  matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => apply(kept()));
  document.addEventListener("DOMContentLoaded", () => {
    apply(kept());
    document.getElementById("theme").addEventListener("click", () => {
      localStorage.setItem("furrow-theme", words[(words.indexOf(kept()) + 1) % words.length]);
      apply(kept());
    });
  });
})();
