//! Pages with places for their parts.

/// Puts each part in the place of its name in braces. What is in a part is not looked
/// at again, and braces around no name stay.
#[must_use]
pub fn fill(template: &str, parts: &[(&str, impl AsRef<str>)]) -> String {
    fill_by(template, |name| {
        let part = parts.iter().find(|(known, _)| *known == name);
        part.map(|(_, part)| part.as_ref())
    })
}

/// Puts in the place of each text in braces what `part` has for it; the others stay.
pub fn fill_by<P: AsRef<str>>(template: &str, part: impl Fn(&str) -> Option<P>) -> String {
    let mut page = String::with_capacity(template.len());
    let mut rest = template;
    while let Some((before, after)) = rest.split_once('{') {
        page.push_str(before);
        let place = after.split_once('}');
        match place.and_then(|(name, after)| Some((part(name)?, after))) {
            Some((part, after)) => {
                page.push_str(part.as_ref());
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
