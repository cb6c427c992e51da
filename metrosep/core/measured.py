"""What people guess that a map or a profile can do; each is one function of an upper layer, nothing is done here."""

from __future__ import annotations

from typing import Any, Self

from metrosep.core.attached import attached

__all__ = ["Guessed"]


class Guessed:
    """Methods of `Surface` and `Profile` that are functions of filters, forms and parameters."""

    __slots__ = ()

    def level(self) -> Self:
        """Return the heights without their least-squares plane, or line.

        Returns
        -------
        Surface or Profile
            What is left; the history names what was removed.

        Raises
        ------
        DegenerateFitError
            If too few points are valid.
        """
        made: Self = attached.verbs["level"](self)
        return made

    def remove_form(self, form: Any = "plane", **options: Any) -> Self:
        """Return what is left of the heights after the best-fit form.

        Parameters
        ----------
        form : Form or str, optional
            An object of `metrosep.forms`, or a text such as "sphere" or "conic: R=50 mm, k=-1.2".
        **options
            Of `metrosep.forms.fit`.

        Returns
        -------
        Surface or Profile
            Measured minus ideal.

        Raises
        ------
        DataError
            If the form or an option is unknown.
        FitError
            If the points do not determine the form.
        """
        made: Self = attached.verbs["remove_form"](self, form, **options)
        return made

    def filter(self, kind: str = "gaussian", **options: Any) -> Self:
        """Return the heights through a filter of ISO 16610.

        Parameters
        ----------
        kind : str, optional
            A function of `metrosep.filters`: "gaussian", "robust_gaussian", "spline", "opening",
            "closing", "dilation", "erosion"; of a profile "primary", "roughness", "waviness" too.
        **options
            Of that function: ``nesting_index="80 um"`` of a map, ``cutoff="0.8 mm"`` of a profile,
            ``band="short"``.

        Returns
        -------
        Surface or Profile
            What passes the filter.

        Raises
        ------
        DataError
            If the filter or an option is unknown.
        """
        made: Self = attached.verbs["filter"](self, kind, **options)
        return made

    def mask(self, shape: str, *, outside: bool = True, **keys: Any) -> Self:
        """Return the heights without what lies outside a region, or inside it.

        Parameters
        ----------
        shape : {"circle", "ring", "rectangle", "polygon", "brush"}
            Of the region. The centre of a pixel decides; edges of a polygon are half-open.
        outside : bool, optional
            True: what lies outside is taken out; False: what lies inside.
        **keys
            As in a step ``mask`` of a recipe, in m or as texts with units: ``diameter``,
            ``inner_diameter``, ``width``, ``height``, ``angle``, ``centre``, ``radius``, ``points``.

        Returns
        -------
        Surface or Profile
            NaN where it was taken out.

        Raises
        ------
        StepError
            If there is no such region.
        TooFewSamplesError
            If nothing is left.
        """
        made: Self = attached.verbs["mask"](self, shape, outside=outside, **keys)
        return made

    def parameters(self, *names: str, **options: Any) -> Any:
        """Return the parameters of ISO 25178-2 of a map, or of ISO 21920-2 of a profile.

        Parameters
        ----------
        *names : str
            Symbols wanted; all if omitted.
        **options
            Of `metrosep.parameters.areal_parameters` or `metrosep.parameters.profile_parameters`.

        Returns
        -------
        ParameterTable
            ``table["Sq"].value`` in SI, ``table.to_frame()``.

        Raises
        ------
        DataError
            If a name or an option is unknown.
        """
        return attached.verbs["parameters"](self, names, **options)

    def step_height(self, **options: Any) -> Any:
        """Return the signed height of a step: of a groove negative.

        Parameters
        ----------
        **options
            Of `metrosep.parameters.step_height`: ``width``, ``middle``, ``kind``, ``axis``.

        Returns
        -------
        StepHeight
            With its standard uncertainty.

        Raises
        ------
        DataError
            If an option is wrong.
        TooFewSamplesError
            If a part holds too few valid samples.
        """
        return attached.verbs["step_height"](self, **options)

    def resample(self, onto: Any = None, **options: Any) -> Self:
        """Return the heights on another grid.

        Parameters
        ----------
        onto : Surface or Profile, optional
            Whose grid is wanted.
        **options
            Of `metrosep.filters.resample`: ``step`` in place of `onto`, ``method``.

        Returns
        -------
        Surface or Profile
            NaN outside what was measured.

        Raises
        ------
        DataError
            If the grid is not given or cannot be made.
        """
        made: Self = attached.verbs["resample"](self, onto, **options)
        return made
