//! Pages with places for their parts.

/// Puts each part in the place of its name in braces. What is in a part is not looked
/// at again, and braces around no name stay.
#[must_use]
pub fn fill(template: &str, parts: &[(&str, impl AsRef<str>)]) -> String {
    let length = parts.iter().map(|(_, part)| part.as_ref().len()).sum();
    let mut page = String::with_capacity(length);
    let mut rest = template;
    while let Some((before, after)) = rest.split_once('{') {
        page.push_str(before);
        let known = after.split_once('}').and_then(|(name, after)| {
            let part = parts.iter().find(|(known, _)| *known == name);
            part.map(|(_, part)| (part.as_ref(), after))
        });
        match known {
            Some((part, after)) => {
                page.push_str(part);
                rest = after;
            }
            None => {
                page.push('{');
                rest = after;
            }
        }
    }
    page + rest
}
