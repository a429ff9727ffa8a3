// A click on one of several small pictures gives it the whole width; a second one makes it small again.
for (const image of document.querySelectorAll(".figures img")) {
  const button = document.createElement("button");
  button.type = "button";
  button.setAttribute("aria-pressed", "false");
  image.replaceWith(button);
  button.append(image);
  button.addEventListener("click", () => {
    const isLarge = button.closest("figure").classList.toggle("large");
    button.setAttribute("aria-pressed", String(isLarge));
  });
}
