//! Archetypes as columns of Arrow tables: which components each consists of, and what they are made of.

use super::{
    Archetype, Class,
    arrays::{bytes, item, no_lists, one_list, rows, structs, text},
};
use crate::{
    Map,
    exchange::half_pixels,
    geometry::{Intrinsics, Pose},
};
use arrow_array::{
    Array, ArrayRef, BooleanArray, FixedSizeListArray, Float32Array, StringArray, StructArray,
    UInt8Array, UInt16Array, UInt32Array,
    types::{Float32Type, UInt8Type},
};
use arrow_schema::{ArrowError, DataType, Field, Fields};
use std::{collections::HashMap, sync::Arc};

/// A component of an archetype, with its values.
pub(super) struct Column {
    /// The archetype and the field of it.
    name: (&'static str, &'static str),
    /// The type that the field is of.
    component: &'static str,
    /// The values of the one row.
    pub(super) values: ArrayRef,
}

impl Column {
    /// As tables call it.
    pub(super) fn name(&self) -> String {
        format!("{}:{}", self.name.0, self.name.1)
    }

    /// What Rerun wants to know of it.
    pub(super) fn metadata(&self) -> HashMap<String, String> {
        let pairs = [
            (
                "rerun:archetype",
                format!("rerun.archetypes.{}", self.name.0),
            ),
            ("rerun:component", self.name()),
            (
                "rerun:component_type",
                format!("rerun.components.{}", self.component),
            ),
        ];
        pairs.map(|(key, value)| (key.to_owned(), value)).into()
    }

    /// The type of a row.
    pub(super) fn row_type(&self) -> DataType {
        DataType::List(item(self.values.data_type(), true))
    }
}

fn column(
    archetype: &'static str,
    field: &'static str,
    component: &'static str,
    values: impl Array + 'static,
) -> Column {
    Column {
        name: (archetype, field),
        component,
        values: Arc::new(values),
    }
}

/// What a recording is called.
pub(super) fn recording_info(name: &str) -> Column {
    column("RecordingInfo", "name", "Name", text(name))
}

/// The components of an archetype.
pub(super) fn columns(archetype: &Archetype) -> Result<Vec<Column>, ArrowError> {
    Ok(match archetype {
        Archetype::ZUp => vec![column(
            "ViewCoordinates",
            "xyz",
            "ViewCoordinates",
            axes([axis::RIGHT, axis::FORWARD, axis::UP])?,
        )],
        Archetype::Classes(classes) => vec![column(
            "AnnotationContext",
            "context",
            "AnnotationContext",
            one_list(annotations(classes)?)?,
        )],
        Archetype::Transform(pose) => transform(pose)?,
        Archetype::Points {
            positions,
            colours,
            radii,
            class,
        } => {
            let colours = colours.iter().copied().map(rgba);
            vec![
                column(
                    "Points3D",
                    "positions",
                    "Position3D",
                    rows::<Float32Type, 3>(positions)?,
                ),
                column(
                    "Points3D",
                    "colors",
                    "Color",
                    UInt32Array::from_iter_values(colours),
                ),
                column(
                    "Points3D",
                    "radii",
                    "Radius",
                    Float32Array::from(radii.clone()),
                ),
                // Few points would have their class's label hang over them, many would not.
                column(
                    "Points3D",
                    "show_labels",
                    "ShowLabels",
                    BooleanArray::from(vec![false]),
                ),
                column(
                    "Points3D",
                    "class_ids",
                    "ClassId",
                    UInt16Array::from(vec![*class]),
                ),
            ]
        }
        Archetype::Pinhole(lens) => pinhole(lens)?,
        Archetype::Picture { file, media_type } => vec![
            column(
                "EncodedImage",
                "blob",
                "Blob",
                one_list(bytes(file.clone()))?,
            ),
            column("EncodedImage", "media_type", "MediaType", text(media_type)),
        ],
        Archetype::Depth(depth) => depth_image(depth)?,
    })
}

/// Directions of axes, as Rerun numbers them.
mod axis {
    pub(super) const UP: u8 = 1;
    pub(super) const DOWN: u8 = 2;
    pub(super) const RIGHT: u8 = 3;
    pub(super) const FORWARD: u8 = 5;
}

fn axes(xyz: [u8; 3]) -> Result<FixedSizeListArray, ArrowError> {
    rows::<UInt8Type, 3>(&[xyz])
}

fn transform(pose: &Pose) -> Result<Vec<Column>, ArrowError> {
    let translation: [f32; 3] = pose.translation.vector.map(|x| x as f32).into();
    // x, y, z, w, as nalgebra has them.
    let quaternion: [f32; 4] = pose.rotation.coords.map(|x| x as f32).into();
    Ok(vec![
        column(
            "Transform3D",
            "translation",
            "Translation3D",
            rows::<Float32Type, 3>(&[translation])?,
        ),
        column(
            "Transform3D",
            "quaternion",
            "RotationQuat",
            rows::<Float32Type, 4>(&[quaternion])?,
        ),
    ])
}

fn pinhole(lens: &Intrinsics) -> Result<Vec<Column>, ArrowError> {
    let lens = half_pixels::lens_to(*lens);
    let [fx, fy, cx, cy] = [lens.fx, lens.fy, lens.cx, lens.cy].map(|x| x as f32);
    let columns_first = [fx, 0.0, 0.0, 0.0, fy, 0.0, cx, cy, 1.0];
    let size = [lens.width as f32, lens.height as f32];
    Ok(vec![
        column(
            "Pinhole",
            "image_from_camera",
            "PinholeProjection",
            rows::<Float32Type, 9>(&[columns_first])?,
        ),
        column(
            "Pinhole",
            "resolution",
            "Resolution",
            rows::<Float32Type, 2>(&[size])?,
        ),
        column(
            "Pinhole",
            "camera_xyz",
            "ViewCoordinates",
            axes([axis::RIGHT, axis::DOWN, axis::FORWARD])?,
        ),
    ])
}

/// The number that Rerun has for pixels of 32 bits, floating.
const F32_PIXELS: u8 = 34;

fn depth_image(depth: &Map<f32>) -> Result<Vec<Column>, ArrowError> {
    let pixels = depth.values().iter().flat_map(|z| z.to_le_bytes());
    // The two that are left out are of other pictures.
    let format: Vec<(Field, ArrayRef)> = vec![
        (
            Field::new("width", DataType::UInt32, false),
            Arc::new(UInt32Array::from(vec![depth.width()])),
        ),
        (
            Field::new("height", DataType::UInt32, false),
            Arc::new(UInt32Array::from(vec![depth.height()])),
        ),
        (
            Field::new("pixel_format", DataType::UInt8, true),
            Arc::new(UInt8Array::new_null(1)),
        ),
        (
            Field::new("color_model", DataType::UInt8, true),
            Arc::new(UInt8Array::new_null(1)),
        ),
        (
            Field::new("channel_datatype", DataType::UInt8, true),
            Arc::new(UInt8Array::from(vec![F32_PIXELS])),
        ),
    ];
    let units_in_a_metre = Float32Array::from(vec![1.0]);
    Ok(vec![
        column(
            "DepthImage",
            "buffer",
            "ImageBuffer",
            one_list(bytes(pixels.collect()))?,
        ),
        column("DepthImage", "format", "ImageFormat", structs(format)?),
        column("DepthImage", "meter", "DepthMeter", units_in_a_metre),
    ])
}

/// The classes, as pairs of a key and what it stands for.
fn annotations(classes: &[Class]) -> Result<StructArray, ArrowError> {
    let ids: ArrayRef = Arc::new(UInt16Array::from_iter_values(
        classes.iter().map(|class| class.id),
    ));
    let labels = StringArray::from_iter_values(classes.iter().map(|class| &class.label));
    let colours = UInt32Array::from_iter_values(classes.iter().map(|class| rgba(class.colour)));
    let info = structs(vec![
        (Field::new("id", DataType::UInt16, false), Arc::clone(&ids)),
        (Field::new("label", DataType::Utf8, true), Arc::new(labels)),
        (
            Field::new("color", DataType::UInt32, true),
            Arc::new(colours),
        ),
    ])?;
    let ends = |name: &str| Field::new(name, DataType::UInt16, false);
    let connection = DataType::Struct(Fields::from(vec![ends("keypoint0"), ends("keypoint1")]));
    let description = structs(vec![
        (
            Field::new("info", info.data_type().clone(), false),
            Arc::new(info.clone()),
        ),
        no_lists("keypoint_annotations", info.data_type(), classes.len())?,
        no_lists("keypoint_connections", &connection, classes.len())?,
    ])?;
    structs(vec![
        (Field::new("class_id", DataType::UInt16, false), ids),
        (
            Field::new("class_description", description.data_type().clone(), false),
            Arc::new(description),
        ),
    ])
}

/// A colour without transparency.
fn rgba([r, g, b]: [u8; 3]) -> u32 {
    u32::from_be_bytes([r, g, b, u8::MAX])
}
