//! Rows of cells as CSV.

/// The rows as CSV (RFC 4180, lines ended by a line feed). Cells are quoted only if
/// necessary.
pub fn csv_text<Row>(rows: impl IntoIterator<Item = Row>) -> String
where
    Row: IntoIterator<Item: AsRef<[u8]>>,
{
    let mut writer = csv::WriterBuilder::new()
        .flexible(true)
        .from_writer(Vec::new());
    for row in rows {
        // Writing to memory does not fail, nor do rows of different lengths.
        let _ = writer.write_record(row);
    }
    let bytes = writer.into_inner().unwrap_or_default();
    String::from_utf8_lossy(&bytes).into_owned()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn cells_with_commas_and_quotes_stay_one_cell() {
        let rows = [["plain", r#"a "b", c"#], ["", "1.5"]];
        assert_eq!(csv_text(rows), "plain,\"a \"\"b\"\", c\"\n,1.5\n");
    }

    #[test]
    fn rows_may_differ_in_length() {
        assert_eq!(csv_text([vec!["a", "b"], vec!["c"]]), "a,b\nc\n");
    }
}
