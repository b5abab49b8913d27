// What has been learned of the marks so far, over the frame that is looked at.

const SHOWN = {
  false: { count: "false", what: "false alarms", meaning: "red: expected here" },
  birth: { count: "births", what: "births", meaning: "green: expected here" },
};
const FEWEST = 10;

export async function drawMaps(progress, number, ask) {
  for (const [name, { count, what, meaning }] of Object.entries(SHOWN)) {
    const image = document.getElementById(`map-${name}`);
    image.style.backgroundImage = `url(/still/${number}.jpg)`;
    const many = progress[count];
    const { picture, learned } = await ask(`/api/map/${name}`);
    image.src = picture;
    image.nextElementSibling.textContent = many < FEWEST ? `${what}: from ${FEWEST} marks on (${many} so far)`
      : learned ? `${many} ${what}; ${meaning}`
      : `${many} ${what}; no place is likelier than others`;
  }
}
