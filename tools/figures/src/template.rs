//! Pages with places for their parts.

/// Puts each part in the place of its name in braces. What is in a part is not looked
/// at again, and braces around no name stay.
#[must_use]
pub fn fill(template: &str, parts: &[(&str, impl AsRef<str>)]) -> String {
    let mut page = String::with_capacity(template.len());
    let mut rest = template;
    while let Some((before, after)) = rest.split_once('{') {
        page.push_str(before);
        let part = after.split_once('}').and_then(|(name, after)| {
            let part = parts.iter().find(|(known, _)| *known == name);
            part.map(|(_, part)| (part.as_ref(), after))
        });
        let (part, after) = part.unwrap_or(("{", after));
        page.push_str(part);
        rest = after;
    }
    page + rest
}
