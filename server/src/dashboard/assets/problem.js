// Requests to the API, and its problem documents.

// The parsed answer; throws a problem document (RFC 9457) for anything else.
export async function request(address, options = {}) {
  let response;
  try {
    response = await fetch(address, options);
  } catch {
    throw { title: 'The service does not answer', detail: 'Check the connection and try again.', errors: [] };
  }
  const text = await response.text();
  if (!response.ok) throw problemOf(response.status, text);
  return text ? JSON.parse(text) : null;
}

export function problemOf(status, text) {
  try {
    const problem = JSON.parse(text);
    return { ...problem, status, errors: problem.errors ?? [] };
  } catch {
    return { title: `The service answered ${status}`, detail: text.slice(0, 500), status, errors: [] };
  }
}

// A notice with the problem's title, detail and fields. Text only: nothing of it is read as HTML.
export function notice(problem) {
  const box = document.createElement('div');
  box.className = 'notice bad';
  box.append(element('strong', problem.title), element('p', problem.detail ?? ''));
  if (problem.errors.length > 0) {
    const list = element('ul', '');
    list.className = 'problems';
    for (const { pointer, detail } of problem.errors) {
      const item = element('li', '');
      item.append(element('code', pointer), ` ${detail}`);
      list.append(item);
    }
    box.append(list);
  }
  return box;
}

export function element(name, text) {
  const made = document.createElement(name);
  made.textContent = text;
  return made;
}
