// What the user has chosen, kept in the browser; where the browser keeps nothing, for as long as the page is open.

export function kept(name) {
  try {
    return localStorage.getItem(`canskin.${name}`);
  } catch {
    return null;
  }
}

export function keep(name, value) {
  try {
    localStorage.setItem(`canskin.${name}`, value);
  } catch {
    // it is forgotten
  }
}
