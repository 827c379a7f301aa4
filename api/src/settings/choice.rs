//! Fields that take several JSON types. Read with a visitor rather than `#[serde(untagged)]`, so that a misspelt
//! field inside is named with its place instead of "did not match any variant".

use std::fmt;

use serde::de::value::{MapAccessDeserializer, SeqAccessDeserializer};
use serde::de::{Error, MapAccess, SeqAccess, Unexpected, Visitor};
use serde::{Deserialize, Deserializer};

use super::{CameraChoice, CustomCamera, Environment, EnvironmentMap};

impl<'de> Deserialize<'de> for CameraChoice {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        struct CameraVisitor;

        impl<'de> Visitor<'de> for CameraVisitor {
            type Value = CameraChoice;

            fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
                f.write_str("a camera's name, its number from 0, or an object with position and target")
            }

            fn visit_u64<E: Error>(self, value: u64) -> Result<CameraChoice, E> {
                u32::try_from(value)
                    .map(CameraChoice::Index)
                    .map_err(|_| E::invalid_value(Unexpected::Unsigned(value), &self))
            }

            fn visit_i64<E: Error>(self, value: i64) -> Result<CameraChoice, E> {
                u32::try_from(value)
                    .map(CameraChoice::Index)
                    .map_err(|_| E::invalid_value(Unexpected::Signed(value), &self))
            }

            fn visit_str<E: Error>(self, value: &str) -> Result<CameraChoice, E> {
                Ok(CameraChoice::Name(value.to_owned()))
            }

            fn visit_map<A: MapAccess<'de>>(self, map: A) -> Result<CameraChoice, A::Error> {
                CustomCamera::deserialize(MapAccessDeserializer::new(map)).map(CameraChoice::Custom)
            }
        }

        deserializer.deserialize_any(CameraVisitor)
    }
}

impl<'de> Deserialize<'de> for Environment {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        struct EnvironmentVisitor;

        impl<'de> Visitor<'de> for EnvironmentVisitor {
            type Value = Environment;

            fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
                f.write_str("a number, a colour [r, g, b], or an object with the hash of a map")
            }

            fn visit_u64<E: Error>(self, value: u64) -> Result<Environment, E> {
                Ok(Environment::Grey(value as f32))
            }

            fn visit_i64<E: Error>(self, value: i64) -> Result<Environment, E> {
                Ok(Environment::Grey(value as f32))
            }

            fn visit_f64<E: Error>(self, value: f64) -> Result<Environment, E> {
                Ok(Environment::Grey(value as f32))
            }

            fn visit_seq<A: SeqAccess<'de>>(self, seq: A) -> Result<Environment, A::Error> {
                <[f32; 3]>::deserialize(SeqAccessDeserializer::new(seq)).map(Environment::Color)
            }

            fn visit_map<A: MapAccess<'de>>(self, map: A) -> Result<Environment, A::Error> {
                EnvironmentMap::deserialize(MapAccessDeserializer::new(map)).map(Environment::Map)
            }
        }

        deserializer.deserialize_any(EnvironmentVisitor)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::json;

    #[test]
    fn a_camera_is_a_name_a_number_or_an_object() {
        let read = |value| serde_json::from_value::<CameraChoice>(value);
        assert_eq!(read(json!("left")).unwrap(), CameraChoice::Name("left".into()));
        assert_eq!(read(json!(2)).unwrap(), CameraChoice::Index(2));
        let custom = read(json!({ "position": [0, 0, 5], "target": [0, 0, 0] })).unwrap();
        assert!(matches!(custom, CameraChoice::Custom(camera) if camera.up == [0.0, 1.0, 0.0]));
        assert!(read(json!({ "positon": [0, 0, 5] })).unwrap_err().to_string().contains("unknown field `positon`"));
        assert!(read(json!(-1)).unwrap_err().to_string().contains("a camera's name"));
    }

    #[test]
    fn an_environment_is_a_number_a_colour_or_a_map() {
        let read = |value| serde_json::from_value::<Environment>(value);
        assert_eq!(read(json!(1)).unwrap(), Environment::Grey(1.0));
        assert_eq!(read(json!(0.5)).unwrap(), Environment::Grey(0.5));
        assert_eq!(read(json!([1, 0.5, 0])).unwrap(), Environment::Color([1.0, 0.5, 0.0]));
        assert!(matches!(read(json!({ "map": "00" })).unwrap(), Environment::Map(map) if map.intensity == 1.0));
        assert!(read(json!([1, 2])).is_err());
        assert!(read(json!("sky")).unwrap_err().to_string().contains("a number, a colour"));
    }

    #[test]
    fn choices_come_back_as_they_were_written() {
        for text in [
            r#""left""#,
            "3",
            r#"{"position":[1.0,2.0,3.0],"target":[0.0,0.0,0.0],"up":[0.0,1.0,0.0],"fov_y_deg":null,"half_height":null}"#,
        ] {
            let choice: CameraChoice = serde_json::from_str(text).unwrap();
            assert_eq!(serde_json::to_string(&choice).unwrap(), text);
        }
    }
}
