//! Escaping for HTML.

use kinegrad_output::block;

/// Text escaped for HTML and attributes, without control characters.
pub fn escape(text: &str) -> String {
    let text = block(text).replace('&', "&amp;").replace('<', "&lt;");
    let text = text.replace('>', "&gt;").replace('"', "&quot;");
    text.replace('\'', "&#39;")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn text_is_neither_markup_nor_control() {
        let text = "<b>'&\"\u{1b}[31m\nnext";
        let escaped = "&lt;b&gt;&#39;&amp;&quot;\\u{1b}[31m\nnext";
        assert_eq!(escape(text), escaped);
    }
}
