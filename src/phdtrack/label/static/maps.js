// What has been learned of the marks so far, over the frame that is looked at.

const SHOWN = {
  false: { count: "false", what: "false alarms", meaning: "red: expected here" },
  birth: { count: "births", what: "births", meaning: "green: expected here" },
};
const FEWEST = 10;

export function drawMaps(progress, number) {
  for (const [name, { count, what, meaning }] of Object.entries(SHOWN)) {
    const image = document.getElementById(`map-${name}`);
    const many = progress[count];
    image.src = `/api/map/${name}.png?${Date.now()}`;
    image.style.backgroundImage = `url(/still/${number}.jpg)`;
    image.nextElementSibling.textContent =
      many < FEWEST ? `${what}: from ${FEWEST} marks on (${many} so far)` : `${many} ${what}; ${meaning}`;
  }
}
