//! Text in lines.

/// Breaks a text between its words.
pub(crate) fn wrap(text: &str, columns: usize) -> impl Iterator<Item = String> {
    let mut lines = vec![String::new()];
    for word in text.split_whitespace() {
        if let Some(line) = lines.last_mut() {
            let is_first = line.is_empty();
            if is_first || line.chars().count() + 1 + word.chars().count() <= columns {
                if !is_first {
                    line.push(' ');
                }
                line.push_str(word);
                continue;
            }
        }
        lines.push(word.to_owned());
    }
    lines.into_iter()
}
