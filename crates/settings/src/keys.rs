//! The keys of a document, from the types that read the document.

use std::fmt;

use schemars::generate::SchemaSettings;
use schemars::{JsonSchema, Schema};
use serde_json::{Map, Value};

/// A key of a document.
#[derive(Clone, Debug, PartialEq)]
pub struct Key {
    /// The dotted key. Repeated tables have `[]` after their name: `take[].motion`.
    pub name: String,
    /// The key's meaning, from the doc comment of its field.
    pub meaning: String,
    /// The allowed values.
    pub values: Values,
    /// The default value of the key; a table above the key may set another default. JSON `null` is
    /// not set.
    pub default: Option<Value>,
    /// True if the key's table requires the key.
    pub required: bool,
    /// The condition on another key of the table: `kind = "disc"`, or one of several values, `kind
    /// = "disc", "square"`.
    pub only_with: Option<String>,
}

/// The allowed values of a key.
#[derive(Clone, Debug, PartialEq)]
pub enum Values {
    /// A table of keys.
    Table,
    /// Any number of tables, `[[name]]`.
    Tables,
    /// `true` or `false`.
    Boolean,
    /// A whole number, 0 or more.
    Count,
    /// A whole number.
    Integer,
    /// A number.
    Number,
    /// Text.
    Text,
    /// One of some names.
    Names(Vec<Name>),
    /// A list, of this length if the length is fixed.
    List(Box<Values>, Option<u64>),
    /// A table with any keys.
    Map(Box<Values>),
    /// One of several kinds.
    Either(Vec<Values>),
}

/// A name that is an allowed value.
#[derive(Clone, Debug, PartialEq)]
pub struct Name {
    /// The name.
    pub name: String,
    /// Its meaning.
    pub meaning: String,
}

impl Values {
    /// The allowed names; empty if other values are allowed too.
    pub fn names(&self) -> &[Name] {
        match self {
            Self::Names(names) => names,
            Self::List(values, _) => values.names(),
            _ => &[],
        }
    }

    /// True for a table of keys.
    pub fn is_table(&self) -> bool {
        matches!(self, Self::Table | Self::Tables)
    }
}

impl fmt::Display for Values {
    /// In words.
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Table => write!(f, "a table"),
            Self::Tables => write!(f, "tables, one for each"),
            Self::Boolean => write!(f, "true or false"),
            Self::Count => write!(f, "a whole number, 0 or more"),
            Self::Integer => write!(f, "a whole number"),
            Self::Number => write!(f, "a number"),
            Self::Text => write!(f, "text in quotes"),
            Self::Names(names) => {
                let names: Vec<String> = names.iter().map(|n| format!("\"{}\"", n.name)).collect();
                match names.split_last() {
                    Some((last, [])) => write!(f, "{last}"),
                    Some((last, others)) => write!(f, "{} or {last}", others.join(", ")),
                    None => write!(f, "a name in quotes"),
                }
            }
            Self::List(values, None) => write!(f, "a list; each: {values}"),
            Self::List(values, Some(length)) => write!(f, "a list of {length}; each: {values}"),
            Self::Map(values) => write!(f, "a table of `name = value` entries; each: {values}"),
            Self::Either(each) => {
                let each: Vec<String> = each.iter().map(ToString::to_string).collect();
                write!(f, "{}", each.join(", or "))
            }
        }
    }
}

/// Every key of the documents that a `T` reads. Tables come before their keys.
pub fn keys_of<T: JsonSchema>() -> Vec<Key> {
    let settings = SchemaSettings::draft2020_12().with(|settings| {
        settings.inline_subschemas = true;
    });
    let schema: Schema = settings.into_generator().into_root_schema_for::<T>();
    let mut keys = Vec::new();
    if let Some(table) = schema.as_object() {
        collect(table, "", None, &mut keys);
    }
    keys
}

/// Adds the keys of a table; `prefix` is the beginning of their names.
fn collect(table: &Map<String, Value>, prefix: &str, only_with: Option<&str>, keys: &mut Vec<Key>) {
    for (name, property) in entries(table, "properties") {
        let Some(property) = property.as_object() else {
            continue;
        };
        let at = keys.len();
        add(property, format!("{prefix}{name}"), only_with, keys);
        let required = table.get("required").and_then(Value::as_array);
        keys[at].required = required.is_some_and(|names| names.iter().any(|n| n == name));
    }
    for variant in alternatives(table) {
        let Some((key, value)) = tag_of(variant) else {
            collect(variant, prefix, only_with, keys);
            continue;
        };
        merge_tag(prefix, key, value, text(variant, "description"), keys);
        let with = format!("{prefix}{key} = \"{value}\"");
        let mut inner = variant.clone();
        if let Some(Value::Object(properties)) = inner.get_mut("properties") {
            properties.remove(key);
        }
        let mut own = Vec::new();
        collect(&inner, prefix, Some(&with), &mut own);
        for added in own {
            let shared = keys
                .iter_mut()
                .find(|known| is_shared(known, &added, &with));
            match shared.and_then(|known| known.only_with.as_mut()) {
                Some(only_with) => *only_with = format!("{only_with}, \"{value}\""),
                None => keys.push(added),
            }
        }
    }
}

/// True if `added`, a key of the kind `with`, also belongs to another kind.
fn is_shared(known: &Key, added: &Key, with: &str) -> bool {
    let tag = with.split(" = ").next();
    let same_tag = |only_with: &String| only_with.split(" = ").next() == tag;
    (&known.name, &known.meaning, &known.values) == (&added.name, &added.meaning, &added.values)
        && known.only_with.as_ref().is_some_and(same_tag)
}

/// Adds one key and all keys below it.
fn add(schema: &Map<String, Value>, name: String, only_with: Option<&str>, keys: &mut Vec<Key>) {
    let values = values_of(schema);
    let below = match &values {
        Values::Table => Some((format!("{name}."), schema)),
        Values::Tables => {
            let items = schema.get("items").and_then(Value::as_object);
            items.map(|items| (format!("{name}[]."), items))
        }
        _ => None,
    };
    // An optional table is one of two alternatives.
    let may_miss = alternatives(schema).any(|each| text(each, "type") == "null");
    let table = || alternatives(schema).find(|each| values_of(each) == Values::Table);
    let of_option = may_miss.then(table).flatten();
    keys.push(Key {
        meaning: plain(text(schema, "description")),
        default: schema.get("default").cloned(),
        required: false,
        only_with: only_with.map(str::to_owned),
        values,
        name,
    });
    if let Some((prefix, table)) = below {
        collect(of_option.unwrap_or(table), &prefix, only_with, keys);
    }
}

/// Adds `value` to the allowed names of a table's tag.
fn merge_tag(prefix: &str, key: &str, value: &str, meaning: &str, keys: &mut Vec<Key>) {
    let name = format!("{prefix}{key}");
    let added = Name {
        name: value.to_owned(),
        meaning: plain(meaning),
    };
    let known = keys.iter_mut().find(|known| known.name == name);
    match known.map(|known| &mut known.values) {
        Some(Values::Names(names)) => names.push(added),
        _ => keys.push(Key {
            name,
            meaning: "Its kind, which decides what other keys there are.".to_owned(),
            values: Values::Names(vec![added]),
            default: None,
            required: true,
            only_with: None,
        }),
    }
}

/// Key and value of the property that names the variant of a table.
fn tag_of(variant: &Map<String, Value>) -> Option<(&str, &str)> {
    let mut properties = entries(variant, "properties");
    properties.find_map(|(name, property)| Some((name.as_str(), property.get("const")?.as_str()?)))
}

fn values_of(schema: &Map<String, Value>) -> Values {
    let names: Vec<Name> = names_of(schema).collect();
    if !names.is_empty() && alternatives(schema).all(|each| names_of(each).next().is_some()) {
        return Values::Names(names);
    }
    let kinds: Vec<&str> = match schema.get("type") {
        Some(Value::String(kind)) => vec![kind],
        Some(Value::Array(kinds)) => kinds.iter().filter_map(Value::as_str).collect(),
        _ => Vec::new(),
    };
    let kind = kinds.into_iter().find(|kind| *kind != "null");
    match kind {
        Some("boolean") => Values::Boolean,
        Some("integer") if schema.get("minimum").is_some() => Values::Count,
        Some("integer") => Values::Integer,
        Some("number") => Values::Number,
        Some("string") => Values::Text,
        Some("array") => {
            let items = schema.get("items").and_then(Value::as_object);
            let items = items.map_or(Values::Text, values_of);
            if items == Values::Table {
                return Values::Tables;
            }
            let length = |key| schema.get(key).and_then(Value::as_u64);
            let fixed = length("minItems").filter(|least| Some(*least) == length("maxItems"));
            Values::List(Box::new(items), fixed)
        }
        Some("object") => {
            let free = schema.get("additionalProperties");
            let free = free.filter(|_| schema.get("properties").is_none());
            let free = free.and_then(Value::as_object);
            free.map_or(Values::Table, |free| Values::Map(Box::new(values_of(free))))
        }
        _ => {
            let is_null = |schema: &&Map<String, Value>| text(schema, "type") == "null";
            let rest = alternatives(schema).filter(|each| !is_null(each));
            let mut each: Vec<Values> = Vec::new();
            for values in rest.map(values_of) {
                match (each.last_mut(), values) {
                    (Some(Values::Names(before)), Values::Names(more)) => before.extend(more),
                    (Some(Values::Table), Values::Table) => {}
                    (_, values) => each.push(values),
                }
            }
            match each.len() {
                1 => each.remove(0),
                _ => Values::Either(each),
            }
        }
    }
}

/// The names that a schema or one of its alternatives allows.
fn names_of(schema: &Map<String, Value>) -> impl Iterator<Item = Name> {
    let name = |name: &Value, meaning: &str| {
        Some(Name {
            name: name.as_str()?.to_owned(),
            meaning: plain(meaning),
        })
    };
    let listed = schema.get("enum").and_then(Value::as_array);
    let listed = listed
        .into_iter()
        .flatten()
        .filter_map(move |n| name(n, ""));
    let meaning = text(schema, "description");
    let single = schema.get("const").and_then(move |n| name(n, meaning));
    let inner = alternatives(schema).flat_map(|each| names_of(each).collect::<Vec<_>>());
    listed.chain(single).chain(inner)
}

/// The alternatives of a schema: one of them, or all, must hold.
fn alternatives(schema: &Map<String, Value>) -> impl Iterator<Item = &Map<String, Value>> {
    let lists = ["oneOf", "anyOf", "allOf"].into_iter();
    let lists = lists.filter_map(|key| schema.get(key).and_then(Value::as_array));
    lists.flatten().filter_map(Value::as_object)
}

fn entries<'a>(
    schema: &'a Map<String, Value>,
    key: &str,
) -> impl Iterator<Item = (&'a String, &'a Value)> {
    let object = schema.get(key).and_then(Value::as_object);
    object.into_iter().flatten()
}

fn text<'a>(schema: &'a Map<String, Value>, key: &str) -> &'a str {
    schema.get(key).and_then(Value::as_str).unwrap_or_default()
}

/// A doc comment as one line of text, without link targets.
fn plain(comment: &str) -> String {
    let joined = comment.split_whitespace().collect::<Vec<_>>().join(" ");
    let mut out = String::new();
    let mut rest = joined.as_str();
    while let Some((before, link)) = rest.split_once('[')
        && let Some((inside, after)) = link.split_once(']')
    {
        out.push_str(before);
        let target = after
            .strip_prefix('(')
            .and_then(|after| after.split_once(')'));
        let is_code = inside.starts_with('`') && inside.ends_with('`');
        match target.is_some() || is_code {
            true => out.push_str(inside),
            false => out.push_str(&format!("[{inside}]")),
        }
        rest = target.map_or(after, |(_, after)| after);
    }
    out + rest
}

#[cfg(test)]
mod tests;
