'use strict';
// Buttons that copy; the text is there without them.
for (const panel of document.querySelectorAll('.panel')) {
  const button = document.createElement('button');
  button.className = 'copy';
  button.textContent = 'Copy';
  button.addEventListener('click', async () => {
    const inverse = document.getElementById('inverse').checked;
    const text = panel.querySelector(inverse ? '.inverse' : '.forward').textContent;
    try {
      await navigator.clipboard.writeText(text);
    } catch (error) {
      const area = document.createElement('textarea');
      area.value = text;
      document.body.append(area);
      area.select();
      document.execCommand('copy');
      area.remove();
    }
    button.textContent = 'Copied';
    setTimeout(() => { button.textContent = 'Copy'; }, 1500);
  });
  panel.append(button);
}
