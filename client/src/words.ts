/** What is said to who wears a headset, and what to who plays on the page; the first that fits counts. */
const ON_THE_PAGE: readonly (readonly [RegExp, string])[] = [
  [/Trigger: go on\. Menu button: measure again\./, "Choose Go on, or Measure again."],
  [/Point at your answer and press the trigger\./, "Choose your answer."],
  [/Press a menu button to stop it\./, "Choose Stop the robot to stop it."],
  [/Press the trigger/g, "Choose Go on"],
  [/press the trigger/g, "choose Go on"],
];

/** The words for somebody who has neither trigger nor menu button. */
export function onThePage(text: string): string {
  return ON_THE_PAGE.reduce((said, [pattern, words]) => said.replace(pattern, words), text);
}
